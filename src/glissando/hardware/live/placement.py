"""Position on the robot of a device that a peer identifies only by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import DeviceError, RobotFileError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import sensor_class
from glissando.model.slide_track import SlideMotion, SlideTrack

_KINDS = ("pose", "coil", "position", "gyro")


class NoTravelError(DeviceError):
    """The travel of the slide that moves a device is unknown at the time of a reading."""


@dataclass(frozen=True)
class Placement:
    """Position of a device on the robot.

    Attributes:
        name: Name of the device in messages.
        arclength: Arclength at which it sits when the travel is zero, m.
        kind: Kind of sensor. If empty, it follows from the message: a TDATA tool of five degrees of
            freedom is a coil, of three a position, and any other value with an orientation a pose.
        slides: Whether the slide moves the device, so that the travel reduces its arclength.
    """

    name: str
    arclength: float
    kind: str = ""
    slides: bool = False

    @classmethod
    def parse(cls, text: str) -> Placement:
        """Parse NAME=METRES, followed by :pose, :coil, :position or :gyro, and :slides.

        Raises:
            DeviceError: The text does not have this form.

        >>> Placement.parse("Tip=0.466:coil")
        Placement(name='Tip', arclength=0.466, kind='coil', slides=False)
        """
        name, _, rest = text.rpartition("=")
        metres, *flags = rest.split(":")
        kinds = [flag for flag in flags if flag != "slides"]
        try:
            arclength = float(metres)
        except ValueError:
            arclength = np.nan
        if not name or not np.isfinite(arclength) or len(kinds) > 1 or {*kinds} - {*_KINDS}:
            raise DeviceError(
                f"{text!r} does not say where a device sits; give NAME=METRES, as in Tip=0.466, "
                f"and after it :pose, :coil, :position or :gyro, and :slides, if need be."
            )
        return cls(name, arclength, kinds[0] if kinds else "", "slides" in flags)


def require_on_robot(placements: Sequence[Placement], robot: Robot) -> None:
    """Check that every device lies on the robot and that the names are unique.

    Raises:
        DeviceError: A device lies off the robot, or two have the same name.
    """
    for place in placements:
        if not 0.0 <= place.arclength <= robot.length:
            raise DeviceError(
                f"{place.name} sits at {place.arclength:g} m, off {robot.name} of "
                f"{robot.length:g} m; correct it (in metres)."
            )
    names = [place.name for place in placements]
    if len({*names}) < len(names):
        raise DeviceError(f"A device is placed twice among {', '.join(names)}; place it once.")


def reading(
    robot: Robot,
    place: Placement,
    kind: str,
    name: str,
    time: float,
    value: Array,
    slide: SlideTrack,
) -> Readings:
    """A single reading with the noise that the robot file states for its kind.

    Args:
        robot: The robot.
        place: Position of the device on the robot.
        kind: Kind of sensor.
        name: Name of the stream.
        time: Session time, s.
        value: Value of one reading of this kind.
        slide: Travel of the slide over time, used if the device slides.

    Raises:
        RobotFileError: The robot file states no noise for this kind of sensor.
        NoTravelError: The device slides, and the travel at that time is unknown; see `SlideTrack`.
    """
    motion = slide.at(time) if place.slides else SlideMotion(0.0)
    if motion is None:
        raise NoTravelError(f"{name} slides, and nothing stated the travel at {time:.3f} s.")
    arclength = np.clip(place.arclength - motion.travel, 0.0, robot.length)
    out = batch(robot, kind, name, np.array([time]), np.array([arclength]), value[None])
    return replace(out, slide_speed=-motion.speed, slide_way=-motion.way)


def batch(
    robot: Robot, kind: str, name: str, time: Array, arclength: Array, values: Array
) -> Readings:
    """A batch of M readings with the noise that the robot file states for their kind.

    Args:
        robot: The robot.
        kind: Kind of sensor.
        name: Name of the stream.
        time: Session times (M,), s.
        arclength: Arclengths (M,) of the readings, m.
        values: Values (M, …), as readings of this kind take them.

    Raises:
        RobotFileError: The robot file states no noise for this kind of sensor.
    """
    std = robot.sensor_std.get(kind)
    if std is None:
        raise RobotFileError(
            f"{name}: robot {robot.name!r} states no noise of a {kind} sensor; add "
            f"[sensors.{kind}] std to the robot file, or give the device another kind."
        )
    return sensor_class(kind)(
        time=time,
        arclength=arclength,
        values=values,
        cov=std**2 if std.size > 1 else std[0] ** 2,
        loss=robot.sensor_loss.get(kind),
        name=name,
    )
