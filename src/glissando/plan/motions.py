"""Motions of the robot itself: how one is written down, and which leaves least uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from glissando import se3
from glissando.errors import GlissandoError
from glissando.grid import Grid
from glissando.plan.judge import judge_of
from glissando.plan.known import Course
from glissando.plan.objectives import Objective
from glissando.plan.outlook import Outlook
from glissando.plan.zones import Zone
from glissando.prior import Prior
from glissando.se3 import Array
from glissando.state import State

_NUDGE = 1e-3  # s, for rates

Shape = Callable[[Array, Array], tuple[Array, Array]]
"""Poses (…, 4, 4) and strains (…, 6) at arclengths and times that broadcast together."""


def course_of(shape: Shape, prior: Prior, arclength: Array) -> Course:
    """The motion whose shapes a function gives, as `foresee` takes it; rates by differences.

    `arclength` (N,) are the nodes of the estimate.
    """

    def course(time: Array) -> State:
        place = np.asarray(arclength, dtype=float)[None, :]
        (pose, strain), (early, bent), (late, later) = (
            shape(place, time[:, None] + shift) for shift in (0.0, -_NUDGE, _NUDGE)
        )
        velocity = se3.log(se3.inverse(early) @ late) / (2.0 * _NUDGE)
        rated = prior.rest_state(Grid(arclength, time[:1])).strain_rate is not None
        return State(pose, strain, velocity, (later - bent) / (2.0 * _NUDGE) if rated else None)

    return course


def choose_motion(
    outlooks: Sequence[Outlook], zones: Sequence[Zone], objective: Objective, arclength: Array
) -> tuple[int, Array]:
    """Which of several motions leaves least uncertainty of the zones, and the value (C,) of each.

    An outlook is one motion's, `foresee(…, course=…)`; `arclength` (T,) is the path of the sensor,
    or (C, T) one a motion. Raises GlissandoError when there is none to choose.
    """
    if not outlooks:
        raise GlissandoError("There is no motion to choose; give one outlook or more.")
    paths = np.broadcast_to(arclength, (len(outlooks), outlooks[0].steps))
    values = np.array(
        [
            judge_of(outlook, zones, objective).value(path)
            for outlook, path in zip(outlooks, paths, strict=True)
        ]
    )
    return int(np.argmin(values)), values
