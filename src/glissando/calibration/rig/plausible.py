"""Plausibility check of a rig's lengths against the robot's, to detect wrong units."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from glissando.calibration.rig.rig import Body, RigData
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.tendons.channel import ends_of

_SPREAD = 0.1  # of the robot's length: largest noise, play and standard deviation of an arclength
_SLIDDEN = 1.5  # of the robot's length: largest travel of a slide
_CORRELATED = 10.0  # of the robot's length: largest correlation length of errors
_MOUNT = 1.0  # m: largest distance of a mount from the backbone
_ROUNDING = 1e-6  # m
_APART = 3.0  # of the robot's length: largest distance of bodies, and of a coil from its median
_NEAR = 0.02  # of the arclength between bodies: smallest distance, except in a closed loop


def require_metres(data: RigData, robot: Robot) -> None:
    """Check that a session's lengths are plausible in metres for this robot.

    Args:
        data: The session.
        robot: The robot.

    Raises:
        RecordingError: A length is too large, as in millimetres, an arclength is off the robot, or
            positions hardly differ, as those in metres that were read as millimetres.
    """
    for what, value, most in _limits(data, robot.length):
        if value > most:
            raise RecordingError(
                f"{what} is {value:.3g} m, more than the {most:g} m that fit robot "
                f"{robot.name!r} of {robot.length:g} m; give metres, not millimetres."
            )
    low, high = ends_of(data.channel, robot.length)
    far = _SPREAD * robot.length + (float(np.abs(data.travel).max()) if data.slides else 0.0)
    places = {f"Body {name!r}": (b.arclength, 0.0, robot.length) for name, b in data.bodies.items()}
    places[f"Coil {data.coil_name!r}"] = data.coil_arclength, low - far, high + far
    for what, (arclength, first, last) in places.items():
        if not first - _ROUNDING <= arclength <= last + _ROUNDING:
            raise RecordingError(
                f"{what} is stated at the arclength {arclength:g} m, off robot {robot.name!r} of "
                f"{robot.length:g} m; give metres from its base, not millimetres."
            )
    _require_near(data, _SPREAD * robot.length)


def _require_near(data: RigData, between: float) -> None:
    """Raise if positions hardly differ, as those in metres that were read as millimetres.

    Args:
        data: The session.
        between: Least difference of arclength (m) of the bodies and positions that are compared.
    """
    pairs = [
        (abs(one.arclength - other.arclength), _distance(one, other))
        for one, other in combinations(data.bodies.values(), 2)
        if abs(one.arclength - other.arclength) > between
    ]
    what, (most, gap) = "Bodies of motion capture", max(pairs, default=(0.0, 0.0))
    wrong = bool(pairs) and all(separation < _NEAR * along for along, separation in pairs)
    if not wrong and data.slides and data.coil_time.size:
        travel = np.interp(data.coil_time, data.slide_time, data.travel)
        what, most = f"Positions of {data.coil_name!r}", float(np.ptp(travel))
        gap = 2.0 * float(_distances_from_median(data.coil).max())
        wrong = most > between and gap < _NEAR * most
    if wrong:
        raise RecordingError(
            f"{what} lie {gap:.2g} m apart, which are {most:.3g} m apart along the robot: they are "
            f"probably in metres, read as millimetres; state their unit."
        )


def _distance(one: Body, other: Body) -> float:
    """Distance of the median positions of two bodies, m."""
    return float(np.linalg.norm(_median_position(one.poses) - _median_position(other.poses)))


def _median_position(poses: Array) -> Array:
    """Median position (3,) of poses (M, 4, 4)."""
    return np.asarray(np.median(poses[:, :3, 3], axis=0))


def _distances_from_median(poses: Array) -> Array:
    """Distances (M,) of poses (M, 4, 4) from their median position."""
    return np.asarray(np.linalg.norm(poses[:, :3, 3] - _median_position(poses), axis=1))


def _limits(data: RigData, length: float) -> list[tuple[str, float, float]]:
    """Description, value and upper limit of each length of a session, m."""
    noise = data.noise
    spreads = {
        "The standard deviation of the coil's arclength": data.coil_arclength_std,
        "The noise of motion capture": noise.mocap[0],
        "The noise of the coil": noise.coil[0],
        "The bias of the tracker": noise.bias[0],
        "The play of the coil's tube": noise.play[0],
        "The backlash": noise.backlash,
    }
    correlated = {"bias of the tracker": noise.bias[2], "play of the coil's tube": noise.play[1]}
    out = [(what, float(value), _SPREAD * length) for what, value in spreads.items()]
    for what, value in correlated.items():
        out.append((f"The correlation length of the {what}", float(value), _CORRELATED * length))
    if data.slides:
        out.append(("The slide's way", float(np.ptp(data.travel)), _SLIDDEN * length))
    if data.coil_time.size:
        stray = float(np.median(_distances_from_median(data.coil)))
        out.append((f"The way of {data.coil_name!r} from its middle", stray, _APART * length))
    for (a, one), (b, other) in combinations(data.bodies.items(), 2):
        distance = _distance(one, other)
        out.append((f"The distance of bodies {a!r} and {b!r}", distance, _APART * length))
    mounts = {f"body {name!r}": body.mount for name, body in data.bodies.items()}
    for name, mount in {**mounts, f"coil {data.coil_name!r}": data.mount}.items():
        out.append((f"The mount of {name}", float(np.linalg.norm(mount[:3, 3])), _MOUNT))
    return out
