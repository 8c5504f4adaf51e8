"""Checks that a posterior was estimated from a recording: same robot, time and readings."""

from __future__ import annotations

import json
from pathlib import Path

from glissando.errors import GlissandoError
from glissando.estimation.posterior import Posterior
from glissando.io.plain_file import plain_text
from glissando.io.provenance import digests
from glissando.model.robot import Robot
from glissando.model.seconds import seconds

_ALIKE = 1e-6  # relative tolerance of lengths, for rounding


def require_pair(
    posterior: Posterior, robot: Robot, name: str, window: tuple[float, float]
) -> None:
    """Require that a posterior and a recording agree in the robot's length and overlap in time.

    Args:
        posterior: Posterior to check.
        robot: Robot of the recording.
        name: Name of the recording, for messages.
        window: First and last time of the recording, s.

    Raises:
        GlissandoError: The robots differ in length, or the times do not overlap.
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
    """A sentence if a recording's files differ from those that a posterior was estimated from.

    Args:
        saved: File of the posterior, with the report of its estimate beside it.
        folder: Folder of the recording.

    Returns:
        The sentence; empty if the files are the same, or if there is no report to compare with.
    """
    try:
        report = json.loads(plain_text(saved.with_name("report.json")))
        known = {f"{name}.csv": report["inputs"][f"{name}.csv"] for name in report["readings"]}
    except (OSError, ValueError, KeyError, TypeError):  # no report, or of an older version
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
