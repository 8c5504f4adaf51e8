"""Motions of the robot itself: written down, drawn, and which leaves least uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.robot import Robot
from glissando.model.state import State
from glissando.planning.belief import Belief, ExpectedMotion, belief_of
from glissando.planning.compare import Foretold, evaluate_path
from glissando.planning.objectives import Objective, Trace
from glissando.planning.path_objective import judge_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planning_problem import PlanningProblem, predict_information
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.planning.zones import Zone

_NUDGE = 1e-3  # s, for rates
_PIECES = 8  # of constant strain between two nodes
_SHORTEST = 0.25  # of the time ahead that a drawn motion lasts

Shape = Callable[[Array, Array], tuple[Array, Array]]
"""Poses (…, 4, 4) and strains (…, 6) at arclengths and times that broadcast together."""


def course_of(shape: Shape, prior: Prior, arclength: Array) -> ExpectedMotion:
    """The motion whose shapes a function gives, its rates by differences.

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
    outlooks: Sequence[PlanningProblem],
    zones: Sequence[Zone],
    objective: Objective,
    arclength: Array,
) -> tuple[int, Array]:
    """Which of several motions leaves least uncertainty of the zones, and the value (C,) of each.

    An outlook is one motion's, `predict_information(…, course=…)`; `arclength` (T,) is the path of
    the sensor, or (C, T) one a motion. Raises GlissandoError when there is none to choose.
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


@dataclass(frozen=True)
class Reshaping:
    """The motion from one strain (N, 6) to another, on a base at `base` (4, 4) that stays there.

    It begins at time `begin` and lasts `lasts` seconds, at rest before and after. A course, as
    `predict_information` takes it.
    """

    prior: Prior
    arclength: Array
    base: Array
    first: Array
    last: Array
    begin: float
    lasts: float

    def __call__(self, time: Array) -> State:
        """The robot at times (K,)."""
        return course_of(self._shape, self.prior, self.arclength)(time)

    def _shape(self, _: Array, time: Array) -> tuple[Array, Array]:
        share = np.clip((time - self.begin) / self.lasts, 0.0, 1.0)[..., None]
        strain = self.first + share**2 * (3.0 - 2.0 * share) * (self.last - self.first)
        pose = np.empty((*strain.shape[:-1], 4, 4))
        pose[:, 0] = self.base
        for n, step in enumerate(np.diff(self.arclength)):
            pose[:, n + 1] = pose[:, n]
            for at in (np.arange(_PIECES) + 0.5) / _PIECES:
                bent = strain[:, n] + at * (strain[:, n + 1] - strain[:, n])
                pose[:, n + 1] = pose[:, n + 1] @ se3.exp(bent * step / _PIECES)
        return pose, strain


def draw_motions(
    known: Robot | Posterior | FixedLagSmoother | Belief,
    shapes: ArrayLike,
    count: int,
    horizon: float,
    seed: int = 0,
) -> list[ExpectedMotion]:
    """Motions from the present shape to others between it and `shapes`, in the time ahead.

    `shapes` (S, N, 6) are strains at the nodes, of shapes that the robot can take: each motion goes
    towards a random mixture of them and the present one, for a random part of `horizon` seconds.
    Raises GlissandoError for other nodes.
    """
    now, rng = belief_of(known), np.random.default_rng(seed)
    held = now.held(Grid(now.arclength, [now.time])).take(0)
    given = np.asarray(shapes, dtype=float)
    if given.shape[1:] != held.strain.shape or not len(given):
        raise GlissandoError(
            f"Shapes to move to are strains {given.shape}; give (S, {len(held.strain)}, 6), one or "
            f"more at the nodes."
        )
    ways = given - held.strain
    out: list[ExpectedMotion] = []
    for _ in range(count):
        share = rng.dirichlet(np.ones(len(ways) + 1))[1:]
        aim = held.strain + np.tensordot(share, ways, 1)
        lasts = horizon * rng.uniform(_SHORTEST, 1.0)
        begin = now.time + rng.uniform(0.0, horizon - lasts)
        out.append(
            Reshaping(now.prior, now.arclength, held.pose[0], held.strain, aim, begin, lasts)
        )
    return out


@dataclass(frozen=True)
class JointPlan:
    """A motion of the robot, None for none, with the sensor's plan for it and what both leave."""

    course: ExpectedMotion | None
    plan: Plan
    told: Foretold


def plan_together(
    known: Robot | Posterior | FixedLagSmoother | Belief,
    courses: Sequence[ExpectedMotion],
    track: PathSpace,
    zones: Sequence[Zone],
    sensor: SlidingSensor | None = None,
    objective: Objective | None = None,
    node_step: float | None = None,
) -> list[JointPlan]:
    """The slide planned for each motion and for none, by what each is foretold to leave.

    The first leaves least, and so no more than a robot that holds its shape. Zones, `sensor` and
    `node_step` are those of `predict_information` and `plan_slide`.
    """
    objective, out = objective or Trace(), []
    for course in (None, *courses):
        outlook = predict_information(
            known, (track.lower, track.upper), track.lasts, sensor,
            course=course, step=track.step, node_step=node_step,
        )  # fmt: skip
        plan = plan_slide(judge_of(outlook, zones, objective), track, zones)
        told = evaluate_path(outlook, zones, objective, plan.arclength)
        out.append(JointPlan(course, plan, told))
    return sorted(out, key=lambda found: found.told.value)
