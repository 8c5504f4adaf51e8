"""Description of a rig: its devices, their frames, and the coils and bodies on the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.drivers import GcodeStage, PositionStage, RemoteStage, Stage
from glissando.hardware.drivers.position_stage import optional_number
from glissando.io.plain_file import file_stem
from glissando.io.robot_file import load_robot
from glissando.io.session_recording import ARCLENGTH_STD
from glissando.io.shipped_robots import beside, robot_file, shipped_robots
from glissando.io.toml_table import read_toml
from glissando.model.table import Table, pose_table
from glissando.model.tendons.channel import Channel, ends_of

_BAUD, _PORT = 115200, 51001


@dataclass(frozen=True)
class Coil:
    """A coil of the tracker on the robot.

    Attributes:
        name: Name in the log and the recording.
        arclength: Arclength when the travel is zero, m.
        slides: Whether the slide moves the coil, so that the travel reduces its arclength.
        serial: Serial number that identifies it; coils without one are assigned in plug order.
        arclength_std: Standard deviation of `arclength`, m.
        slide: Name of the further stage that moves it; empty for the first stage.
        channel: Channel beside the backbone in which it slides, along which its arclength is then
            measured; None for a coil on the backbone.
    """

    name: str
    arclength: float
    slides: bool = True
    serial: str = ""
    arclength_std: float = ARCLENGTH_STD
    slide: str = ""
    channel: Channel | None = None

    @property
    def slide_topic(self) -> str:
        """Topic of the stage that moves the coil."""
        return slide_topic(self.slide)

    def arclengths(self, travel: Array, length: float) -> Array:
        """Arclengths (M,), m, at travels (M,) m of the slide, clipped to a robot of `length` m."""
        place = self.arclength - travel if self.slides else np.full(travel.shape, self.arclength)
        return np.clip(place, *ends_of(self.channel, length))

    def off(self, stroke: tuple[float, float], length: float) -> float:
        """Largest distance, m, beyond an end of a robot of `length` m on a stroke; ≤ 0 if none."""
        low, high = ends_of(self.channel, length)
        most = self.arclength - stroke[0] - high, low - self.arclength + stroke[1]
        return max(most) if self.slides else 0.0

    def described(self) -> dict[str, Any]:
        """Description of the coil in a session log, in JSON's types."""
        out: dict[str, Any] = {"arclength": self.arclength, "arclength_std": self.arclength_std}
        out |= {"slides": self.slides, "slide": self.slide}
        return out | ({"channel": self.channel.to_table()} if self.channel else {})


def slide_topic(name: str) -> str:
    """Topic of a stage's readings in a session log; the first stage has an empty name."""
    return f"/slide/{name}" if name else "/slide"


def _standing_travel(stage: PositionStage | None, standing: float | None) -> float:
    """Travel of a stage at rest after homing, m; zero if there is no stage."""
    home = stage.home if stage and standing is None else standing
    low, high = stage.stroke if stage else (0.0, 0.0)
    return min(max(home or 0.0, low), high)


@dataclass(frozen=True)
class FurtherStage:
    """A stage beside the first: name, address, settings, and travel when recording begins."""

    name: str
    address: str
    stage: PositionStage
    standing: float | None = None

    @property
    def standing_travel(self) -> float:
        """Travel at rest after homing, m."""
        return _standing_travel(self.stage, self.standing)


@dataclass(frozen=True)
class Body:
    """A motion-capture object at `arclength` m, with `mount` its pose T_bm in the cross-section.

    An object that `slides` is on the sliding tube; its arclength is NaN and its mount is unused.
    """

    name: str
    arclength: float
    mount: Array
    slides: bool = False


@dataclass(frozen=True)
class Rig:
    """The devices of an experiment; the address of an absent device is None.

    Attributes:
        name: Name of the rig.
        robot: Shipped robot, or path of a robot file.
        tracker: Address of the Aurora, of an OpenIGTLink peer whose devices are the coils, or of a
            ROS 2 graph whose topics are the coils.
        coils: The tracker's coils.
        slide: Serial path of the slide's servo or controller, or the address of its peer.
        stage: Settings of the stage at `slide`.
        standing: Travel when recording begins, m; None to home the slide at its stop.
        mocap: UDP port of motion capture.
        mocap_host: Address of this computer on which motion capture is received.
        bodies: Objects of motion capture.
        baud: Baud rate of the tracker's serial line.
        frame: T_world,tracker (4, 4), as far as it is known.
        further: Stages beside the first, each with coils of its own.
    """

    name: str
    robot: str
    tracker: str | None = None
    coils: tuple[Coil, ...] = ()
    slide: str | None = None
    stage: PositionStage | None = None
    standing: float | None = None
    mocap: int | None = None
    bodies: tuple[Body, ...] = ()
    baud: int = _BAUD
    frame: Array = field(default_factory=lambda: np.eye(4))
    further: tuple[FurtherStage, ...] = ()
    mocap_host: str = "127.0.0.1"

    @property
    def standing_travel(self) -> float:
        """Travel of the slide at rest after homing, m."""
        return _standing_travel(self.stage, self.standing)

    def described(self) -> dict[str, Any]:
        """Description of the rig in a session log, in JSON's types."""
        sliding = next((c for c in self.coils if c.slides), None)
        shipped = self.robot in shipped_robots()
        robot = self.robot if shipped else str(Path(self.robot).resolve())
        return {
            "name": self.name,
            "robot": robot,
            "coils": {c.name: c.described() for c in self.coils},
            "coil_arclength": sliding.arclength if sliding else None,
            "coil_arclength_std": sliding.arclength_std if sliding else None,
            "direction": -1,
            "frame": pose_table(self.frame),
            "bodies": {
                b.name: {"slides": True}
                if b.slides
                else {"arclength": b.arclength, **pose_table(b.mount)}
                for b in self.bodies
            },
        }


def pose_of(entries: Mapping[str, Any]) -> Array:
    """Pose (4, 4) from the position (m) and quaternion [w, x, y, z] of a message."""
    rotation = se3.rotation_from_quaternion(np.array(entries["quaternion"]))
    return se3.pose(rotation, np.array(entries["position"]))


def load_rig(path: str | Path) -> Rig:
    """Read a setup file.

    Args:
        path: TOML file in the format of docs/rig.md.

    Raises:
        DeviceError: A key is missing or unknown, or its value is invalid.
    """
    path = Path(path)
    table = read_toml(path, DeviceError)
    name, robot = table.text("name", path.stem), table.text("robot")
    robot = beside(path.parent, robot)
    length = load_robot(robot_file(robot)).length
    tracker, slide, mocap = (table.table(key) for key in ("tracker", "slide", "mocap"))
    further = tuple(_further(entry) for entry in table.tables("slides"))
    table.close()
    if tracker is None and mocap is None:
        raise DeviceError(f"{path.name}: nothing to record; add [tracker], [mocap] or both.")
    devices: dict[str, Any] = {"further": further}
    if tracker:
        devices |= {"frame": _pose(tracker, 3.0), "tracker": tracker.text("address")}
        devices |= {"baud": int(tracker.number("baud", _BAUD))}
        devices |= {"coils": _coils(tracker, length)}
    if slide:
        devices |= _slide(slide)
    if mocap:
        devices |= {"mocap": int(mocap.number("port", _PORT))}
        devices |= {"mocap_host": mocap.text("host", Rig.mocap_host)}
        devices |= {"bodies": tuple(_body(entry, length) for entry in mocap.tables("bodies"))}
        mocap.close()
    _require_unique(path.name, "slides", [one.name for one in further])
    _require_unique(path.name, "bodies", [body.name for body in devices.get("bodies", ())])
    stages = {"": devices.get("stage"), **{one.name: one.stage for one in further}}
    for coil in devices.get("coils", ()):
        _require_valid_stage(path.name, coil, stages, length)
    return Rig(name, robot, **devices)


def _require_valid_stage(
    where: str, coil: Coil, stages: Mapping[str, PositionStage | None], length: float
) -> None:
    """Raise DeviceError for a coil of an unknown stage, or one that a stage moves off the robot."""
    if coil.slide not in stages:
        raise DeviceError(
            f"{where}: coil {coil.name} is moved by {coil.slide!r}; name one of [[slides]]."
        )
    stage = stages[coil.slide]
    if stage and (off := coil.off(stage.stroke, length)) > 3.0 * coil.arclength_std:
        raise DeviceError(
            f"{where}: coil {coil.name} at {coil.arclength:g} m leaves the robot by {off:.3g} m on "
            f"the stroke {list(stage.stroke)} m; correct one of them."
        )


def _require_unique(where: str, what: str, names: list[str]) -> None:
    """Raise DeviceError for a repeated name, as messages of both would be mixed."""
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise DeviceError(f"{where}: two {what} are {repeated[0]!r}; give each its own.")


def _further(table: Table) -> FurtherStage:
    name = table.text("name")
    if not name.isidentifier():
        raise table.fail("name", f"is {name!r}; give letters, digits and underscores.")
    parts = _slide(table)
    return FurtherStage(name, parts["slide"], parts["stage"], parts["standing"])


def _coils(table: Table, length: float) -> tuple[Coil, ...]:
    coils = []
    for entry in table.tables("coils"):
        name, channel = file_stem(entry.text("name"), DeviceError), entry.channel()
        arclength = _arclength(entry, ends_of(channel, length)[1])
        slides, serial = not entry.flag("fixed"), entry.text("serial", "")
        std = entry.number("arclength_std", ARCLENGTH_STD)
        if std > 0.1 * length:
            raise entry.fail("arclength_std", f"is {std:g} m; give metres, not millimetres.")
        slide = entry.text("slide", "")
        coils.append(Coil(name, arclength, slides, serial, std, slide, channel))
        entry.close()
    table.close()
    if not coils:
        raise DeviceError(f"{table.where}: no coil is named; add [[tracker.coils]].")
    _require_unique(table.where, "coils", [coil.name for coil in coils])
    serials = [coil.serial for coil in coils if coil.serial]
    _require_unique(table.where, "serial numbers of coils", serials)
    return tuple(coils)


def _slide(table: Table) -> dict[str, Any]:
    address = table.text("address")
    standing = optional_number(table, "standing")
    kinds: dict[str, type[PositionStage]] = {
        "dynamixel": Stage,
        "grbl": GcodeStage,
        "remote": RemoteStage,
    }
    usual = "remote" if is_remote(address) else "dynamixel"
    protocol = table.text("protocol", usual, choices=tuple(kinds))
    if (protocol == "remote") != is_remote(address):
        raise table.fail("protocol", f"is {protocol!r}, which {address!r} does not speak.")
    stage = kinds[protocol].from_table(table)
    if standing is None and stage.home is None:
        raise DeviceError(
            f"{table.where}: the position of the stage is unknown; give `home`, its mechanical "
            f"stop, or `standing`, its travel when recording begins."
        )
    return {"slide": address, "standing": standing, "stage": stage}


def is_remote(address: str) -> bool:
    """Whether an address is of OpenIGTLink or ROS 2."""
    return address.startswith("igtl") or address.partition("?")[0] == "ros2"


def _body(table: Table, length: float) -> Body:
    name = file_stem(table.text("name"), DeviceError)
    if table.flag("slides"):
        body = Body(name, np.nan, np.eye(4), slides=True)
    else:
        body = Body(name, _arclength(table, length), _pose(table, 1.0))
    table.close()
    return body


def _pose(table: Table, most: float) -> Array:
    """Read a pose (4, 4), and check that each coordinate of its position is at most `most` m."""
    pose = table.pose()
    if np.abs(pose[:3, 3]).max() > most:
        raise table.fail(
            "position",
            f"is {pose[:3, 3].tolist()}, more than {most:g} m away; give metres, not millimetres.",
        )
    return pose


def _arclength(table: Table, length: float) -> float:
    arclength = table.number("arclength", positive=False)
    if not 0.0 <= arclength <= length:
        raise table.fail(
            "arclength", f"is {arclength:g} m, off the robot of {length:g} m; correct it."
        )
    return arclength
