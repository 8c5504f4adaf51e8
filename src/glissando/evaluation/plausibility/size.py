"""Positions and arclengths too small to be in metres: divided by a thousand once too often."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.plausibility.reach import distance_from_base
from glissando.evaluation.plausibility.session import Streams, weights
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings

_NEAR = (
    0.02  # of a sensor's arclength: nearer to the base all the time only a closed loop brings it
)
_AWAY = 0.1  # of the robot's length, from where on that is asked
_TINY = 1e-6, 1.01e-3  # of the robot's length: where no sensor sits, though one at its tip in mm


def check_size(streams: Streams) -> Iterator[Finding]:
    """Findings on trackers that stay at the base though they sit along the robot, or hardly do.

    Args:
        streams: A session.

    Yields:
        Findings; those on arclengths alone are warnings.
    """
    robot = streams.robot
    low, high = (share * robot.length for share in _TINY)
    looped = [r for r in streams.tracked if _at_base(robot, r)]
    tiny = [r for r in streams.tracked if low < r.arclength.max() < high]
    for suspects, refusal in ((looped, True), (tiny, False)):
        if not suspects:
            continue
        names = tuple(r.label for r in suspects)
        farthest = max(suspects, key=lambda r: r.arclength.max())
        place, seen = farthest.arclength.max(), f"a robot of {robot.length:.3g} m"
        if refusal:
            near = distance_from_base(robot, farthest).max()
            seen = f"never more than {near:.2g} m from the base of {seen}, as if that were a loop"
        yield Finding(
            "length-unit",
            f"{listed(names)} sit{'s' * (len(suspects) == 1)} at arclengths up to {place:.2g} m, "
            f"{'' if refusal else 'on '}{seen}: lengths are probably in metres, read as "
            f"millimetres; give metres, or leave out length_unit.",
            refusal, names, "metres, read as millimetres",
        )  # fmt: skip


def _at_base(robot: Robot, r: Readings) -> bool:
    """Whether a tracker that sits along the robot stays where its known base is."""
    away = r.arclength > _AWAY * robot.length
    moved = any(p.kind == "frame" and r.name in p.streams for p in robot.sensor_parameters)
    if moved or not robot.prior.fixes_base or weights(r)[0] == 0.0 or not away.any():
        return False
    near = distance_from_base(robot, r) < _NEAR * r.arclength
    return bool(np.all(near[away]))
