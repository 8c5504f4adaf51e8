"""The best motion of a scene: search from several starts, at the allowed risk.

The search limits an upper bound of the risk, computed for balls about places of the body. The risk
of the result is then sampled at closer places, and the limit of the bound adjusted until the
sampled risk is near the allowed one.

The tendon speed that corrections need is stated with the plan. From one correction to the next the
estimate of the model error changes with the covariance P⁻ − P⁺ of the filter. Displacements that
keep the bends change by −B⁺ E times this, with Jacobians B of the bends by displacements and E by
the model error.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import FalseConfidenceWarning, GlissandoError, PlanWarning
from glissando.estimation.tendon_prediction import warn_of_weight
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.motion_search import Search, judged_closely
from glissando.planning.scene.motion_space import motion_space
from glissando.planning.scene.motion_starts import (
    reach_target,
    require_clear_targets,
    require_possible_start,
    slide_ways,
    starts,
)
from glissando.planning.scene.sampled_risk import sample_risk
from glissando.planning.scene.scene import Scene
from glissando.planning.scene.scene_checks import require_scene, unsure_numbers
from glissando.planning.scene.sensor_errors import SensorErrors, sensor_errors
from glissando.planning.scene.tendon_body import tendon_body

Progress = Callable[[int, int, str], None]
"""Called with the number of parts done, the number of all parts and a note."""

_SPACING = 0.5  # robot radii between two places of the body, at most
_PLACES = 80  # places over the whole body, at most; the balls about fewer places are larger
_PIECES = 12  # pieces of a path, unless that makes them shorter than a second
_SHARE = 0.9  # share of the allowed risk that a plan aims at
_BRIEF = 12  # iterations of each candidate
_EVEN = 4  # moments per correction interval in figures
_ROUNDS = 3  # rounds of adjusting the limit of the bound, and of adding moments
_LIKELY = 2.0  # standard deviations
_EASE = 1e-3  # relative singular value of the bends' Jacobian below which none is corrected


@dataclass(frozen=True)
class MotionPlan:
    """A planned motion with its evaluation and its sampled risk.

    Attributes:
        problem: The problem that it solves.
        evaluation: Shapes, uncertainty and cost of the motion.
        risk: Sampled probability of a collision.
        risk_std: Standard deviation of `risk` as an estimate.
        allowed: Limit of the risk bound in the search that led to the motion.
    """

    problem: MotionProblem
    evaluation: Evaluation
    risk: float
    risk_std: float
    allowed: float

    def commands(self) -> tuple[Array, Array]:
        """Times (S,), s, at 20 Hz, and values (S, C) of tendons and slides, m."""
        count = max(2, round(20.0 * self.problem.scene.horizon) + 1)
        time = np.linspace(0.0, self.problem.scene.horizon, count)
        return time, self.problem.space.basis_at(time) @ self.evaluation.control.T

    @property
    def miss(self) -> float:
        """Largest distance of the expected tip from a target at its time, m."""
        space, tip = self.problem.space, self.evaluation.tip
        return max(
            float(np.linalg.norm(tip[space.moment_at(target.time)] - target.position))
            for target in self.problem.scene.targets
        )

    def evenly(self) -> MotionPlan:
        """The same plan evaluated at uniform times, four per correction interval."""
        space = self.problem.space
        corrected = _EVEN * np.arange(space.corrected.size)
        moments = np.linspace(0.0, space.moments[-1], int(corrected[-1]) + 1)
        problem = replace(self.problem, space=replace(space, moments=moments, corrected=corrected))
        return replace(self, problem=problem, evaluation=problem.evaluate(self.evaluation.control))

    @property
    def warning(self) -> str:
        """Warning that tendons are too slow for corrections, so the risk is too small; or empty."""
        scene = self.problem.scene
        left = scene.reserve * min(tendon.speed for tendon in scene.tendons)
        needed = correction_speed(self.problem, self.evaluation)
        if needed <= left:
            return ""
        return (
            f"Corrections of what is read take tendons up to {1e3 * needed:.3g} mm/s (95 %), and "
            f"the plan leaves {1e3 * left:.3g} mm/s to them: hits may be more frequent than is "
            f"stated. Raise reserve in [tendons], or correction, the time for each."
        )


def motion_problem(
    scene: Scene, robot: Robot, *, step: float | None = None, senses: bool = True
) -> MotionProblem:
    """Set up the motion planning problem of a scene for a robot.

    Args:
        scene: The scene.
        robot: The robot, with [tendons] and a mechanical prior.
        step: Duration of a piece of the paths, s; by default a twelfth of the horizon, but at
            least 1 s.
        senses: Whether future readings are taken into account.

    Raises:
        GlissandoError: The scene is invalid, or does not fit this robot.

    Warns:
        FalseConfidenceWarning: The robot's weight, which is neglected, moves it by more than the
            stated uncertainty; or the risk neglects uncertain sensor parameters or the uncertainty
            of learned tendon parameters.
        PlanWarning: No sensor parameter of the robot concerns a sensor of the scene.
    """
    require_scene(scene, robot)
    spacing = max(_SPACING * scene.robot_radius, robot.length / _PLACES)
    body = tendon_body(robot, spacing)
    straight = body.shapes(np.zeros((1, len(body.rod.tendons)))).pose[0, -1]
    sensed, neglected = sensor_errors(scene.sensors, robot, straight)
    if senses:
        _warn_of_sensors(scene, robot, sensed, neglected)
    size = body.errors + sensed.std.size  # the belief is the prior of the robot file
    belief = ErrorBelief.unknown(size)
    warn_of_weight(robot, body.straight_std)
    if unsure := unsure_numbers(robot):
        warnings.warn(unsure, FalseConfidenceWarning, stacklevel=2)
    step = step or max(1.0, scene.horizon / _PIECES)
    space = motion_space(scene, step)
    return MotionProblem(scene, body, belief, space, senses, sensed)


def _warn_of_sensors(scene: Scene, robot: Robot, sensed: SensorErrors, unknown: list[str]) -> None:
    """Warn of unknown sensor parameters that the risk neglects, or if none are of the scene."""
    others = sorted({s for p in robot.sensor_parameters if not p.known for s in p.streams})
    if scene.sensors and others and not (unknown or sensed.parameters):
        named = ", ".join(sorted({sensor.name for sensor in scene.sensors}))
        warnings.warn(
            f"No sensor parameter is of a sensor of the scene ({named}), so the risk counts none; "
            f"where one slides as {', '.join(others)}, give it that name.",
            PlanWarning,
            stacklevel=3,
        )
    if not unknown:
        return
    warnings.warn(
        f"The risk leaves out that {', '.join(unknown)} {'is' if len(unknown) < 2 else 'are'} not "
        f"known: hits may be far more frequent than is stated. Calibrate the sensor, and state "
        f"what was found without a std.",
        FalseConfidenceWarning,
        stacklevel=3,
    )


def plan_motion(
    problem: MotionProblem, *, seed: int = 0, candidates: int = 5, iterations: int = 60,
    warm_start: Array | None = None, progress: Progress | None = None,
) -> MotionPlan:  # fmt: skip
    """Plan the motion of least cost within the risk that the scene allows.

    Args:
        problem: The problem.
        seed: Seed of the random starts and of the samples of the risk.
        candidates: Number of starts, the best ones, that are improved.
        iterations: Largest number of iterations for the best of these.
        warm_start: Control points (C, S+2) of a further start, m.
        progress: Called after each part of the search.

    Raises:
        GlissandoError: No motion found satisfies the scene; the message names the part that is
            violated, and by how much.
    """
    if candidates < 1 or iterations < 1:
        raise GlissandoError(
            f"candidates and iterations are {candidates} and {iterations}; give 1 or more."
        )
    with one_thread():
        require_possible_start(problem)
        require_clear_targets(problem)
        reaches = [reach_target(problem, k) for k in range(len(problem.scene.targets))]
        first = starts(problem, np.stack(reaches), seed, warm_start)
        search = Search(problem, problem.scene.delta * _SHARE)
        merits = [search.value(control) for control in first]
        ranked = _distinct_in_tendons(
            [first[k] for k in np.argsort(merits, kind="stable")], len(problem.scene.tendons)
        )[:candidates]
        motions = []
        for part, control in enumerate(ranked):
            way = min(slide_ways(problem, control), key=search.value)
            motions.append(search.improve(way, _BRIEF))
            if progress:
                progress(part + 1, len(ranked) + _ROUNDS, f"cost {motions[-1].cost:.4g}")
        search, best = improved(search, min(motions, key=search.merit), iterations)
        return _checked(_adjust_limit(search, best, iterations, seed, progress, len(ranked)))


def _distinct_in_tendons(motions: list[Array], count: int) -> list[Array]:
    """Motions (C, S+2) without those whose first `count` rows, the tendons, are duplicates."""
    first: dict[bytes, Array] = {}
    for motion in motions:
        first.setdefault(motion[:count].tobytes(), motion)
    return list(first.values())


def improved(search: Search, motion: Evaluation, iterations: int) -> tuple[Search, Evaluation]:
    """Improve a motion; returns the search with all moments that the motion needs, and the motion.

    An improved motion may need moments that the search did not evaluate; the search is then
    repeated with them.
    """
    for _ in range(_ROUNDS):
        motion = search.improve(motion.control, iterations)
        count = search.problem.space.moments.size
        search, motion = judged_closely(search, motion)
        if search.problem.space.moments.size == count:
            break
    return search, motion


def _adjust_limit(
    search: Search, best: Evaluation, iterations: int, seed: int,
    progress: Progress | None, parts: int,
) -> MotionPlan:  # fmt: skip
    """Adjust the limit of the risk bound until the sampled risk is near the allowed one."""
    problem, delta = search.problem, search.problem.scene.delta
    allowed = _SHARE * delta
    plan: MotionPlan | None = None
    for part in range(_ROUNDS):
        risk, std = sample_risk(problem, best, seed=seed)
        new = MotionPlan(problem, best, risk, std, allowed)
        if risk <= delta and (
            plan is None or plan.risk > delta or best.cost <= plan.evaluation.cost
        ):
            plan = new
        plan = plan or new
        if progress:
            progress(parts + part + 1, parts + _ROUNDS, f"risk {100 * risk:.3g} %")
        binding = best.hits.value > 0.5 * allowed
        enough = 0.7 * delta <= risk <= delta or (risk < delta and not binding)
        if enough or part == _ROUNDS - 1 or (risk > delta and search.missed(best)):
            break
        allowed *= float(np.clip(_SHARE * delta / max(risk, 1e-4), 0.2, 3.0))
        search = replace(search, allowed=allowed)
        search, best = improved(search, best, iterations)
        problem = search.problem
    assert plan is not None
    return plan


def _checked(plan: MotionPlan) -> MotionPlan:
    """The plan; raises GlissandoError if it exceeds the risk or misses a target."""
    scene = plan.problem.scene
    for target in scene.targets:
        k = plan.problem.space.moment_at(target.time)
        miss = float(np.linalg.norm(plan.evaluation.tip[k] - target.position))
        if miss > target.tolerance:
            raise GlissandoError(
                f"With a risk of {100 * scene.delta:.3g} % the tip comes no nearer than "
                f"{1e3 * miss:.3g} mm to the target {target.position.tolist()} m by "
                f"{target.time:g} s, and {1e3 * target.tolerance:.3g} mm are asked for; allow more "
                f"risk, time or distance."
            )
    if plan.risk > scene.delta + 2.0 * plan.risk_std:
        raise GlissandoError(
            f"A risk of {100 * scene.delta:.3g} % was not reached: the best motion found hits with "
            f"{100 * plan.risk:.3g} %. Allow more, give more time or sensing, or move what is in "
            f"the way."
        )
    return plan


def correction_speed(problem: MotionProblem, at: Evaluation) -> float:
    """Largest tendon speed for corrections, in addition to the plan's (95 % quantile), m/s.

    Args:
        problem: The problem.
        at: The evaluated motion.
    """
    corrected, known = problem.space.corrected, at.known.corrections
    balance, by_error = at.shapes.balance, at.shapes.strain_by_error
    count, moments = len(problem.scene.tendons), len(known.before)
    by_pull = balance.strain_by_displacement()[corrected, :, 3:5].reshape(moments, -1, count)
    by_error = by_error[corrected, :, 3:5].reshape(moments, by_pull.shape[1], -1)
    pulled = np.linalg.pinv(by_pull, rcond=_EASE) @ by_error
    learned = known.own(known.before - known.after)
    variance = np.einsum("ktq,kqp,ktp->kt", pulled, learned, pulled)
    return float(_LIKELY * np.sqrt(max(variance.max(), 0.0)) / problem.space.correction)
