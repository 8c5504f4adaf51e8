"""Three files as a laboratory has them after an experiment, from a simulated rig.

aurora.csv is what the tracker's program exports, in the tracker's own frame and time; vicon.csv
what motion capture exports; stage.csv where the slide was, by a program that writes semicolons and
decimal commas. Nobody has measured where the tracker stands, how the coil sits in its tube, or how
much later than motion capture the tracker began: `glissando calibrate` finds it.

Run as: python examples/raw_exports.py [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file
from glissando.simulation import SlidePath, load_bench
from glissando.simulation.bench import Actuation, Tendon
from glissando.simulation.tracker import coil_rows, mocap_rows

LATE, SECONDS, BODIES = 0.12, 16.0, (0.0, 0.34, 0.58, 0.7)  # s, s, m
EPOCH = 1778067471.0  # s since 1970 when motion capture begins; the tracker begins later
WAYS = 5e-3 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # of four tendons, m
PULLS = np.array(
    [[8, 0, 0, 0], [8, 0, 0, 0], [0, 7, 0, 0], [0, 7, 0, 0], [0, 0, 6, 3], [2, 5, 0, 0.0]]
)  # N


def main(folder: Path) -> None:
    """Simulate the experiment and write the three files."""
    rng = np.random.default_rng(3)
    bench = load_bench(robot_file("sliding700"))
    fair = {"bias": 3e-4, "bias_angle": 3e-3, "play": 1e-4, "mocap": 1.5e-4, "mocap_angle": 1.5e-3}
    flaws = replace(
        bench.flaws, set_curvature=0.3, registration=0.0, registration_angle=0.0, **fair
    )
    bench = replace(bench, flaws=flaws, tendons=tuple(Tendon(way, 0.7, 0.0) for way in WAYS))
    motion = bench.move(
        Actuation(np.linspace(0, SECONDS, len(PULLS)), PULLS, np.zeros(3)), flaws, 0
    )
    path = SlidePath.calibrate(SECONDS, 0.06, bench.slide)

    time = np.arange(LATE, SECONDS, 1.0 / 40.0)
    T_wt = bench.tracker @ se3.exp(rng.normal(0.0, 0.3, 6))
    coil = coil_rows(motion, path, time, 0.0, T_wt, flaws, rng)
    mount = se3.exp(np.array([4e-4, -3e-4, 0.0, 0.01, -0.015, 0.0]))
    aurora(folder / "aurora.csv", EPOCH + coil.time, coil.values @ mount)
    rows = [mocap_rows(motion, s, np.arange(0, SECONDS, 0.05), flaws, rng) for s in BODIES]
    vicon(folder / "vicon.csv", [f"body_{1e3 * s:.0f}" for s in BODIES], rows)
    knots = np.arange(0.0, SECONDS, 0.02)
    lines = [
        f"{t:.3f};{1e3 * x:.4f}".replace(".", ",")
        for t, x in zip(knots, path.at(knots), strict=True)
    ]
    (folder / "stage.csv").write_text("Time (s);Travel (mm)\n" + "\n".join(lines) + "\n")


def aurora(file: Path, time, poses) -> None:
    """The columns of NDI's programs: quaternions w, x, y, z, and millimetres."""
    lines = ["Port 1: coil,Frame,Time [sec],State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"]
    for k, (t, pose) in enumerate(zip(time, poses, strict=True)):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        numbers = ",".join(f"{v:.7g}" for v in (w, x, y, z, *(1e3 * pose[:3, 3])))
        lines.append(f"Port 1: coil,{1000 + k},{t:.4f},OK,{numbers},0.1")
    file.write_text("\n".join(lines) + "\n")


def vicon(file: Path, names, rows) -> None:
    """The columns of Tracker: helical rotations in radians, and millimetres; frames at 20 Hz."""
    heads = "".join(f",{name}:{name},,,,," for name in names)
    axes, units = ",RX,RY,RZ,TX,TY,TZ" * len(names), ",rad,rad,rad,mm,mm,mm" * len(names)
    lines = ["Objects", "20", f",{heads}", f"Frame,Sub Frame{axes}", f",{units}"]
    for k in range(len(rows[0].time)):
        poses = [row.values[k] for row in rows]
        turns = [Rotation.from_matrix(pose[:3, :3]).as_rotvec() for pose in poses]
        cells = [
            v
            for turn, pose in zip(turns, poses, strict=True)
            for v in (*turn, *(1e3 * pose[:3, 3]))
        ]
        lines.append(f"{k + 1},0," + ",".join(f"{v:.7g}" for v in cells))
    file.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
