"""A robot as cheap as can be simulated and estimated, and a study of it."""

from pathlib import Path

ROBOT = """\
name = "stub"
length = 0.3

[grid]
arclength_nodes = 2
time_rate = 2.0

[base]
psd_pose = [1e-6, 1e-4]
psd_strain = [1, 1]
psd_velocity = [1e-2, 1]

[prior]
kind = "white-noise"
psd_velocity_time = [1, 1]
psd_strain_arclength = [1, 1]
psd_strain_time = [1, 1]
psd_velocity_arclength = [1, 1]

[sensors.coil]
std = [1e-3, 1e-2]

[physics]
young = 60e9
poisson = 0.33
density = 6450
disk_radius = 6e-3
truth_arclengths = [0.3]
tubes = [{ outer = 2.0e-3 }]

[physics.slide]
stroke = 0.06
speed = 0.024
acceleration = 0.1

[physics.full_slide]
stroke = 0.3
speed = 0.1
acceleration = 0.2

[physics.tracker]

[physics.shapes.straight]
tensions = []
"""

# The coil holds still at the tip and is read twice, at the grid's two times: a cell takes 15 ms.
STUDY = """\
name = "stub"
seeds = {seeds}

[fixed]
robot = "stub.toml"
shape = "straight"
slide = "hold"
duration = 0.025
encoder = 0
set = 0

[grid]
{grid}
"""

BUCKLED = """\
tensions = []

[[loads]]
arclength = 0.3
force = [0, 0, -1000]
"""


def write_study(folder: Path, grid: str, seeds: int = 1) -> Path:
    """The file of a study whose axes are the lines of `grid`, with its robot beside it.

    What is swept is not fixed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stub.toml").write_text(ROBOT)
    (folder / "buckled.toml").write_text(BUCKLED)
    file = folder / "study.toml"
    swept = tuple(line.split("=")[0] + "=" for line in grid.splitlines())
    lines = STUDY.format(grid="", seeds=seeds).splitlines()
    kept = [line for line in lines if not (swept and line.startswith(swept))]
    file.write_text("\n".join([*kept, grid, ""]))
    return file
