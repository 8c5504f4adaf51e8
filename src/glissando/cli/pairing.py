"""A posterior belongs to a recording only if it is of the same robot and time."""

from __future__ import annotations

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.model.robot import Robot
from glissando.model.seconds import seconds

_ALIKE = 1e-6  # of a length, for rounding


def require_pair(
    posterior: Posterior, robot: Robot, name: str, window: tuple[float, float]
) -> None:
    """Make sure that a posterior can be of a recording.

    Args:
        posterior: The posterior.
        robot: The recording's robot.
        name: Name of the recording.
        window: First and last time of the recording that counts, s.

    Raises:
        GlissandoError: Its robot has another length, or no time is in both.
    """
    length, time = float(posterior.grid.arclength[-1]), posterior.grid.time
    if abs(length - robot.length) > _ALIKE * robot.length:
        raise GlissandoError(
            f"The posterior is of a robot of {length:g} m, {name} of {robot.name} with "
            f"{robot.length:g} m; give the recording that it was estimated from, or its --robot."
        )
    if time[-1] < window[0] or time[0] > window[1]:
        raise GlissandoError(
            f"The posterior runs from {seconds(time[0], time[-1])} s, {name} from "
            f"{seconds(*window)} s; give the recording that it was estimated from."
        )
