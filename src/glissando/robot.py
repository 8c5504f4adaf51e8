"""Robot files: length, rest strain, base, grid, prior and sensor noise, as validated TOML."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glissando.errors import OutsideGridError, RobotFileError
from glissando.grid import Grid
from glissando.noise import GemanMcClure, Huber, Loss
from glissando.prior import STRAIGHT, BaseDensity, KinematicPrior
from glissando.se3 import Array
from glissando.sensors import ROWS
from glissando.tables import Table, read_toml

_LOSSES: dict[str, type[Huber] | type[GemanMcClure]] = {
    "huber": Huber,
    "geman-mcclure": GemanMcClure,
}
_MOST_NODES = 1_000_000
_SHIPPED = Path(__file__).parent / "robots"


@dataclass(frozen=True)
class Robot:
    """What is known of a robot before any reading.

    `length` in metres, `arclength_nodes` (N,) in metres, `time_rate` nodes a second, `prior`,
    `sensor_std` standard deviations and `sensor_loss` robust losses by kind of sensor, `clip` the
    gyro's range in rad/s or None.
    """

    name: str
    length: float
    arclength_nodes: Array
    time_rate: float
    prior: KinematicPrior
    sensor_std: dict[str, Array]
    sensor_loss: dict[str, Loss]
    clip: float | None = None

    def grid(self, start: float, stop: float) -> Grid:
        """The robot's grid over the times [start, stop] in seconds."""
        count = max(2, round((stop - start) * self.time_rate) + 1)
        if count > _MOST_NODES:
            raise OutsideGridError(
                f"{start:g} to {stop:g} s at {self.time_rate:g} nodes a second would be {count:,} "
                f"time nodes; choose a shorter window or a lower time_rate."
            )
        return Grid(self.arclength_nodes, np.linspace(start, stop, count))


def shipped_robots() -> list[str]:
    """Names of the robots that come with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def robot_file(name: str | Path) -> Path:
    """The file of a shipped robot by name, or of any robot by path. Raises RobotFileError."""
    if str(name) in shipped_robots():
        return _SHIPPED / f"{name}.toml"
    path = Path(name)
    if not path.exists():
        raise RobotFileError(
            f"There is no robot named {str(name)!r} and no such file; give a TOML file or one of "
            f"{', '.join(shipped_robots())}."
        )
    return path


def load_robot(name: str | Path) -> Robot:
    """A robot by the name of a shipped one or by the path of a robot file.

    Raises RobotFileError naming the file and the offending key.

    >>> load_robot("tdcr466").length
    0.466
    """
    return parse_robot(read_toml(robot_file(name), RobotFileError))


def parse_robot(table: Table) -> Robot:
    """The robot a TOML table describes."""
    name = table.text("name", Path(table.where).stem)
    length = table.number("length")
    rest_strain = table.vector("rest_strain", 6, STRAIGHT)
    nodes, rate = _grid(table, length)
    base_pose, base = _base(table)
    prior = _prior(table, rest_strain, base_pose, base)
    std, loss, clip = _sensors(table)
    table.skip("physics")  # of the simulator, which checks it
    table.close()
    return Robot(name, length, nodes, rate, prior, std, loss, clip)


def _grid(table: Table, length: float) -> tuple[Array, float]:
    grid = table.table("grid", required=True)
    assert grid is not None
    rate = grid.number("time_rate")
    if isinstance(grid.peek("arclength_nodes"), list):
        nodes = grid.vector("arclength_nodes", len(grid.peek("arclength_nodes")))
        if nodes.size == 0 or nodes[0] != 0.0 or np.any(np.diff(nodes) <= 0.0):
            raise grid.fail("arclength_nodes", "must begin at 0 and increase.")
        if abs(nodes[-1] - length) > 1e-9:
            raise grid.fail(
                "arclength_nodes", f"ends at {nodes[-1]:g} m; end it at the length, {length:g} m."
            )
    else:
        count = grid.number("arclength_nodes")
        if count != int(count) or count < 2:
            raise grid.fail(
                "arclength_nodes",
                f"is {count:g}; give a whole number from 2 up, or the nodes themselves.",
            )
        nodes = np.linspace(0.0, length, int(count))
    grid.close()
    return nodes, rate


def _base(table: Table) -> tuple[Array, BaseDensity | None]:
    base = table.table("base")
    if base is None:
        return np.eye(4), None
    pose = base.pose()
    density = BaseDensity(
        *(base.vector(f"psd_{part}", 6, positive=True) for part in ("pose", "strain", "velocity"))
    )
    base.close()
    return pose, density


def _prior(
    table: Table, rest_strain: Array, base_pose: Array, base: BaseDensity | None
) -> KinematicPrior:
    prior = table.table("prior", required=True)
    assert prior is not None
    prior.text("kind", choices=["kinematic"])
    names = ("velocity_time", "strain_arclength", "strain_time", "velocity_arclength")
    densities = {f"psd_{name}": prior.vector(f"psd_{name}", 6, positive=True) for name in names}
    prior.close()
    return KinematicPrior(**densities, base=base, rest_strain=rest_strain, base_pose=base_pose)


def _sensors(table: Table) -> tuple[dict[str, Array], dict[str, Loss], float | None]:
    std: dict[str, Array] = {}
    losses: dict[str, Loss] = {}
    clip = None
    sensors = table.table("sensors")
    if sensors is None:
        return std, losses, clip
    for kind in sensors.names():
        if kind not in ROWS:
            raise sensors.fail(kind, f"is not a kind of sensor; known: {', '.join(ROWS)}.")
        sensor = sensors.table(kind, required=True)
        assert sensor is not None
        std[kind] = sensor.std(ROWS[kind])
        if kind == "gyro":
            limit = sensor.number("clip", 1e9)
            clip = limit if limit < 1e9 else None
        name = sensor.text("loss", "none", choices=("none", *_LOSSES))
        if name != "none":
            loss = _LOSSES[name]
            losses[kind] = loss(sensor.number("threshold", loss().threshold))
        sensor.close()
    return std, losses, clip
