"""Lengths of a rig against the robot's: those in millimetres do not fit it."""

from __future__ import annotations

import numpy as np

from glissando.calibration.rig.rig import RigData
from glissando.errors import RecordingError
from glissando.model.robot import Robot
from glissando.model.tendons.channel import ends_of

_SPREAD = 0.1  # of the robot's length: noise, play and doubt about an arclength are less
_SLIDDEN = 1.5  # of the robot's length: what a slide travels at most
_CORRELATED = 10.0  # of the robot's length: how far errors are correlated at most
_MOUNT = 1.0  # m from the backbone at most
_ROUNDING = 1e-6  # m


def require_metres(data: RigData, robot: Robot) -> None:
    """Check that what a session states of lengths can be of this robot.

    Args:
        data: The session.
        robot: The robot.

    Raises:
        RecordingError: A length is too large, as one in millimetres is, or is off the robot.
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


def _limits(data: RigData, length: float) -> list[tuple[str, float, float]]:
    """What each length of a session is of, its value and the largest that can be, m."""
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
    mounts = {f"body {name!r}": body.mount for name, body in data.bodies.items()}
    for name, mount in {**mounts, f"coil {data.coil_name!r}": data.mount}.items():
        out.append((f"The mount of {name}", float(np.linalg.norm(mount[:3, 3])), _MOUNT))
    return out
