"""A posterior belongs to a recording only if it is of the same robot and time."""

from __future__ import annotations

import json
from pathlib import Path

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.io.plain_file import plain_text
from glissando.io.provenance import digests
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


def other_readings(saved: Path, folder: Path) -> str:
    """A sentence, if a recording's readings are not those that a posterior was estimated from.

    Args:
        saved: The posterior, the report of its estimate beside it or not.
        folder: The recording.
    """
    try:
        report = json.loads(plain_text(saved.with_name("report.json")))
        known = {f"{name}.csv": report["inputs"][f"{name}.csv"] for name in report["readings"]}
    except (OSError, ValueError, KeyError, TypeError):  # of before, or of others: nobody knows
        return ""
    present = digests(folder / name for name in known if (folder / name).is_file())
    differ = [name for name, digest in present.items() if digest != known[name]]
    if not differ and present:
        return ""
    why = f"{', '.join(differ)} differ" if differ else f"it has no {', '.join(known)}"
    return (
        f"{saved} was estimated from other readings than those of {folder} ({why}): what is "
        f"compared may be two motions. Give the recording that it was estimated from."
    )
