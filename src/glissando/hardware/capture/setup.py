"""What a rig is made of: which devices, where they are, and what rides where on the robot."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.drivers import Stage
from glissando.io.robot_file import load_robot, robot_file
from glissando.io.toml_table import Table, read_toml

_ZERO_STD = 2e-3  # m: how well one measures by hand where the coil is


@dataclass(frozen=True)
class Coil:
    """A coil of the tracker, at `arclength` m, less the slide's travel if it `slides`.

    Coils are plugged in in the order they are given, unless `serial` says which one it is.
    """

    name: str
    arclength: float
    slides: bool = True
    serial: str = ""
    arclength_std: float = _ZERO_STD

    def places(self, travel: Array) -> Array:
        """Arclengths (M,) m at travels (M,) m of the slide."""
        return self.arclength - travel if self.slides else np.full(travel.shape, self.arclength)


@dataclass(frozen=True)
class Body:
    """A motion-capture object at `arclength` m; `mount` (4, 4) is where it sits there, T_bm."""

    name: str
    arclength: float
    mount: Array


@dataclass(frozen=True)
class Rig:
    """The devices of an experiment by their addresses, None where there is none.

    `standing` m is the slide's travel when recording begins; None homes it at its stop. `frame`
    (4, 4) is where the tracker stands in the world, as far as that is known.
    """

    name: str
    robot: str
    tracker: str | None
    coils: tuple[Coil, ...]
    slide: str | None
    stage: Stage | None
    standing: float | None
    mocap: int | None
    bodies: tuple[Body, ...]
    baud: int = 115200
    frame: Array = field(default_factory=lambda: np.eye(4))

    def described(self) -> dict[str, Any]:
        """What a session log says of the rig, as JSON has it."""
        sliding = next((c for c in self.coils if c.slides), None)
        return {
            "name": self.name,
            "robot": self.robot,
            "coils": {c.name: {"arclength": c.arclength, "slides": c.slides} for c in self.coils},
            "coil_arclength": sliding.arclength if sliding else None,
            "coil_arclength_std": sliding.arclength_std if sliding else None,
            "direction": -1,
            "frame": _placed(self.frame),
            "bodies": {b.name: {"arclength": b.arclength, **_placed(b.mount)} for b in self.bodies},
        }


def _placed(pose: Array) -> dict[str, list[float]]:
    quaternion = se3.quaternion(pose[:3, :3])
    return {"position": pose[:3, 3].tolist(), "quaternion": quaternion.tolist()}


def load_rig(path: str | Path) -> Rig:
    """Read a setup file. Raises DeviceError with the key that is wrong and what to do."""
    path = Path(path)
    table = read_toml(path, DeviceError)
    name, robot = table.text("name", path.stem), table.text("robot")
    beside = path.parent / robot
    robot = str(beside) if beside.is_file() else robot
    length = load_robot(robot_file(robot)).length
    tracker, slide, mocap = (table.table(key) for key in ("tracker", "slide", "mocap"))
    table.close()
    if tracker is None and mocap is None:
        raise DeviceError(f"{path.name}: nothing to record; add [tracker], [mocap] or both.")
    frame = tracker.pose() if tracker else np.eye(4)
    coils, address, baud = _coils(tracker, length) if tracker else ((), None, 115200)
    stage_at, standing, stage = _slide(slide) if slide else (None, None, None)
    port = bodies = None
    if mocap:
        port = int(mocap.number("port", 51001))
        bodies = tuple(_body(entry, length) for entry in mocap.tables("bodies"))
        mocap.close()
    return Rig(
        name, robot, address, coils, stage_at, stage, standing, port, bodies or (), baud, frame
    )


def _coils(table: Table, length: float) -> tuple[tuple[Coil, ...], str, int]:
    address, baud = table.text("address"), int(table.number("baud", 115200))
    coils = []
    for entry in table.tables("coils"):
        coils.append(
            Coil(
                entry.text("name"),
                _place(entry, length),
                not entry.flag("fixed"),
                entry.text("serial", ""),
                entry.number("arclength_std", _ZERO_STD),
            )
        )
        entry.close()
    table.close()
    if not coils:
        raise DeviceError(f"{table.where}: no coil is named; add [[tracker.coils]].")
    return tuple(coils), address, baud


def _slide(table: Table) -> tuple[str, float | None, Stage]:
    address = table.text("address")
    standing = None
    if table.peek("standing") is not None:
        standing = table.number("standing", positive=False)
    else:
        table.skip("standing")
    stage = Stage.from_table(table)
    if standing is None and stage.home is None:
        raise DeviceError(
            f"{table.where}: nobody knows where the stage is; give `home`, its mechanical stop, or "
            f"`standing`, its travel when recording begins."
        )
    return address, standing, stage


def _body(table: Table, length: float) -> Body:
    body = Body(table.text("name"), _place(table, length), table.pose())
    table.close()
    return body


def _place(table: Table, length: float) -> float:
    place = table.number("arclength", positive=False)
    if not 0.0 <= place <= length:
        raise table.fail("arclength", f"is {place:g} m, off the robot of {length:g} m; correct it.")
    return place
