"""Motions of the robot: given as functions, drawn at random, and planned with the slide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.state import State
from glissando.planning.belief import BeliefSource, ExpectedMotion, belief_of
from glissando.planning.compare import PathEvaluation, evaluate_path
from glissando.planning.objectives import Objective, Trace
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planning_problem import predict_information
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.planning.zones import Zone

_DT = 1e-3  # s, step of the finite differences for rates
_PIECES = 8  # pieces of constant strain between two nodes
_SHORTEST = 0.25  # share of the horizon, the shortest motion that is drawn

Shape = Callable[[Array, Array], tuple[Array, Array]]
"""Maps arclengths and times, broadcast together, to poses (…, 4, 4) and strains (…, 6)."""


def expected_motion(shape: Shape, prior: Prior, arclength: Array) -> ExpectedMotion:
    """Expected motion from a function for shapes; rates are central differences.

    Args:
        shape: Poses and strains as a function of arclength and time.
        prior: Prior of the estimate.
        arclength: Arclength nodes (N,) of the estimate, m.
    """
    return partial(_state, shape, prior, arclength)


def _state(shape: Shape, prior: Prior, arclength: Array, time: Array) -> State:
    place = np.asarray(arclength, dtype=float)[None, :]
    (pose, strain), (pose_before, strain_before), (pose_after, strain_after) = (
        shape(place, time[:, None] + shift) for shift in (0.0, -_DT, _DT)
    )
    velocity = se3.log(se3.inverse(pose_before) @ pose_after) / (2.0 * _DT)
    rate = (strain_after - strain_before) / (2.0 * _DT)
    still = prior.rest_state(Grid(arclength, time[:1]))
    rates = [rate, np.zeros_like(rate)][: len(still.fields()) - 3]
    return State(pose, strain, velocity, *rates)


def _blended(
    base: Array, strains: Array, begin: float, duration: float, arclength: Array, time: Array
) -> tuple[Array, Array]:
    """Poses and strains of a smooth blend of two strains (2, N, 6), with fixed base (4, 4)."""
    share = np.clip((time - begin) / duration, 0.0, 1.0)[..., None]
    strain = strains[0] + share**2 * (3.0 - 2.0 * share) * (strains[1] - strains[0])
    pose = np.empty((*strain.shape[:-1], 4, 4))
    pose[:, 0] = base
    for n, step in enumerate(np.diff(arclength[0])):
        pose[:, n + 1] = pose[:, n]
        for at in (np.arange(_PIECES) + 0.5) / _PIECES:
            piece = strain[:, n] + at * (strain[:, n + 1] - strain[:, n])
            pose[:, n + 1] = pose[:, n + 1] @ se3.exp(piece * step / _PIECES)
    return pose, strain


def draw_motions(
    source: BeliefSource, shapes: ArrayLike, count: int, horizon: float, seed: int = 0
) -> list[ExpectedMotion]:
    """Draw motions from the current shape to random convex combinations with given shapes.

    Args:
        source: Estimate or robot to plan for.
        shapes: Strains (S, N, 6) at the arclength nodes, of shapes that the robot can take.
        count: Number of motions.
        horizon: Planning horizon, s; a motion takes a random part of it.
        seed: Seed of the random numbers.

    Raises:
        GlissandoError: The shapes are not given at the arclength nodes of the estimate.
    """
    belief, rng = belief_of(source), np.random.default_rng(seed)
    present = belief.hold_shape(Grid(belief.arclength, [belief.time])).take(0)
    strains = np.asarray(shapes, dtype=float)
    if strains.shape[1:] != present.strain.shape or not len(strains):
        raise GlissandoError(
            f"Shapes to move to are strains {strains.shape}; give (S, {len(present.strain)}, 6), "
            f"one or more at the nodes."
        )
    motions = []
    for _ in range(count):
        share = rng.dirichlet(np.ones(len(strains) + 1))[1:]
        last = present.strain + np.tensordot(share, strains - present.strain, 1)
        duration = horizon * rng.uniform(_SHORTEST, 1.0)
        begin = belief.time + rng.uniform(0.0, horizon - duration)
        ends = np.stack([present.strain, last])
        shape = partial(_blended, present.pose[0], ends, begin, duration)
        motions.append(expected_motion(shape, belief.prior, belief.arclength))
    return motions


@dataclass(frozen=True)
class JointPlan:
    """A motion of the robot with the sensor's plan for it.

    Attributes:
        motion: Motion of the robot; None if it holds its shape.
        plan: The sensor's plan.
        evaluation: Uncertainty of the zones after both.
    """

    motion: ExpectedMotion | None
    plan: Plan
    evaluation: PathEvaluation


def plan_jointly(
    source: BeliefSource,
    motions: Sequence[ExpectedMotion],
    path_space: PathSpace,
    zones: Sequence[Zone],
    sensor: SlidingSensor | None = None,
    objective: Objective | None = None,
    node_step: float | None = None,
) -> list[JointPlan]:
    """Plan the slide for each motion and for a robot that holds its shape, the best plan first.

    Args:
        source: Estimate or robot to plan for.
        motions: Motions that the robot can make.
        path_space: Admissible paths of the sensor.
        zones: Zones of interest.
        sensor: The sliding sensor; by default the coil of the robot file.
        objective: Objective over the zones; by default `Trace()`.
        node_step: Approximate time between nodes, s, as `predict_information` takes it.
    """
    objective, plans = objective or Trace(), []
    reach = path_space.lower, path_space.upper
    for motion in (None, *motions):
        problem = predict_information(
            source, reach, path_space.duration, sensor,
            motion=motion, step=path_space.step, node_step=node_step,
        )  # fmt: skip
        plan = plan_slide(path_objective_of(problem, zones, objective), path_space, zones)
        evaluation = evaluate_path(problem, zones, objective, plan.arclength)
        plans.append(JointPlan(motion, plan, evaluation))
    return sorted(plans, key=lambda joint: joint.evaluation.value)
