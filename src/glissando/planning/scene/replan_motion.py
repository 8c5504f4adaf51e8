"""Receding-horizon planning: while a plan is executed, the rest of it is replanned repeatedly.

Readings change the estimate of the model error, and thus where the rest of the motion may pass and
where the slides should be. The risk of the parts already executed is subtracted from the allowed
risk; the rest of the motion may take what remains. If no continuation keeps this limit, the robot
is brought to rest as fast as its actuators can stop.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError, PlanWarning
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings
from glissando.planning.path_space import PathSpace
from glissando.planning.planners import InlinePlanner, Planner, PlannerExitedError
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.follow import MotionFollower
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.motion_search import Search, judged_closely
from glissando.planning.scene.motion_space import motion_space
from glissando.planning.scene.plan_motion import MotionPlan
from glissando.planning.scene.sampled_risk import sample_risk

_ITERATIONS = 5  # iterations of the search: the current plan is a good start
_ROUNDS = 2  # rounds of these, at most, until the risk is allowed
_SHARE = 0.9  # share of the allowed risk that the search aims at
_LEAST_RISK = 1e-4  # risk allowed for the rest if the executed parts took more than all
_BEFORE, _ROUNDING = 1e-3, 1e-6  # s, step of the difference for speeds; rounding of times
_SLOWER = 1.0 - 1e-6  # factor on a speed, so that rounding does not exceed a limit
_SHORTEST = 2.0  # pieces of the plan's paths, below which the rest is not replanned


@dataclass
class MotionReplanner:
    """Commands for a control loop with replanning, with the interface of `MotionFollower`.

    All times are from the start of the first plan, s.

    Attributes:
        plan: The first plan.
        every: Time between two plans, s.
        lead: Time after the newest command at which a plan begins, s; at least the planner's
            computing time.
        planner: Computes the plans; by default in the caller's own thread.
        follower: Follower of the newest plan.
        begun: Start time of the newest plan.
        spent: Risk of the executed parts of earlier plans.
        stopped: Reason why the robot was brought to rest before its target; otherwise empty.
        exceeded: Reason why the newest plan exceeds the remaining risk; otherwise empty.
        plans: Number of plans adopted after the first.
    """

    plan: MotionPlan
    every: float = 1.0
    lead: float = 0.0
    planner: Planner[Continuation] = field(default_factory=InlinePlanner)
    follower: MotionFollower = field(init=False)
    begun: float = field(default=0.0, init=False)
    spent: float = field(default=0.0, init=False)
    stopped: str = field(default="", init=False)
    exceeded: str = field(default="", init=False)
    plans: int = field(default=0, init=False)
    _replanned: Continuation | None = field(default=None, init=False)
    _due: float | None = field(default=None, init=False)
    _next: float = field(init=False)

    def __post_init__(self) -> None:
        self.follower, self._next = MotionFollower(self.plan), self.every

    def command(self, time: float) -> Array:
        """Command: values (C,) that all actuators should reach at a time, s, in m."""
        self._take_over()
        if self._due is None and time > self._next and not self.stopped:
            self._submit()
            self._take_over()
        return self.follower.command(time - self.begun)

    def at(self, time: ArrayLike) -> Array:
        """Commanded values (…, C) of all actuators, m, at times (…), s, as of the last command."""
        return self.follower.at(np.asarray(time, dtype=float) - self.begun)

    def advance(self, time: float) -> None:
        """Predict the belief to a time, s, without readings."""
        self.follower.advance(time - self.begun)

    def add(self, readings: Readings) -> None:
        """Update the belief with readings of a sensor since the last command."""
        self.follower.add(readings.changed(time=readings.time - self.begun))

    def _submit(self) -> None:
        follower, problem = self.follower, self.follower.problem
        start = follower.due + _rounded_up(self.lead, problem.scene.correction)
        last = max(target.time for target in problem.scene.targets)
        if last - start < _SHORTEST * problem.space.paths[0].step:
            self._next = np.inf
            return
        speed = (follower.planned(start) - follower.planned(start - _BEFORE)) / _BEFORE
        allowed = self.plan.problem.scene.delta - self.spent
        belief = follower.belief.after(start - follower.time, problem.time_scale)
        values = follower.at(start)
        state = values, _stoppable_speed(problem.space.paths, values, speed)
        self.planner.submit(partial(continue_motion, follower.plan, start, state, belief, allowed))
        self._due, self._next = start, self.begun + start + self.every

    def _take_over(self) -> None:
        """Adopt the submitted plan when its start is reached, if it is ready in time."""
        due = self._due
        if due is None:
            return
        try:
            replanned = self._replanned = self._replanned or self.planner.result()
        except GlissandoError as problem:
            self._due = None
            self._next = np.inf if isinstance(problem, PlannerExitedError) else self._next
            what = str(problem).rstrip(".")
            warnings.warn(f"{what}; the last plan goes on.", PlanWarning, stacklevel=3)
            return
        if replanned is None or self.follower.due < due - _ROUNDING:
            return
        self._replanned = self._due = None
        if self.follower.due > due + _ROUNDING:
            warnings.warn(
                f"A plan for {self.begun + due:.3g} s came later than that and is not followed; "
                f"give a longer lead.",
                PlanWarning,
                stacklevel=3,
            )
            return
        if replanned.plan is None:
            return
        old = self.follower
        self.follower = MotionFollower(replanned.plan, old.belief, old.time - due)
        self.begun, self.spent = self.begun + due, self.spent + replanned.spent
        self.stopped, self.exceeded = replanned.stopped, replanned.exceeded
        self.plans += 1


def _stoppable_speed(paths: Sequence[PathSpace], values: Array, speed: Array) -> Array:
    """Speeds (C,) reduced so that the paths can stop from values (C,) within their limits."""
    low, high, sharpest = np.array([[p.lower, p.upper, p.acceleration] for p in paths]).T
    room = np.where(speed > 0.0, high - values, values - low)
    fastest = _SLOWER * np.sqrt(2.0 * sharpest * np.maximum(room, 0.0))
    return np.clip(speed, -fastest, fastest)


def _rounded_up(time: float, correction: float) -> float:
    """The time rounded up to a multiple of the correction interval."""
    return float(np.ceil(time / correction - _ROUNDING) * correction)


@dataclass(frozen=True)
class Continuation:
    """Result of `continue_motion`.

    Attributes:
        plan: The new plan; None to keep the current one.
        spent: Risk of the executed part of the current plan, up to the start of the new one.
        stopped: Reason why the new plan comes to rest before the target; otherwise empty.
        exceeded: Reason why the new plan exceeds the remaining risk; otherwise empty.
    """

    plan: MotionPlan | None
    spent: float
    stopped: str = ""
    exceeded: str = ""


def continue_motion(
    plan: MotionPlan, start: float, state: tuple[Array, Array], belief: ErrorBelief,
    allowed: float,
) -> Continuation:  # fmt: skip
    """Replan the rest of a motion, or stop the robot if its risk would be too large.

    Args:
        plan: The current plan.
        start: Start of the rest, s from the plan's start.
        state: Values, m, and speeds, m/s, (C,) of all actuators at `start`.
        belief: Belief about model error and sensor errors at `start`.
        allowed: Risk allowed from the start of the current plan on.
    """
    with one_thread():
        before = np.searchsorted(plan.problem.space.moments, start - _ROUNDING)
        spent = sample_risk(plan.problem, plan.evaluation, moments=int(before))[0]
        remaining = max(allowed - spent, _LEAST_RISK)
        try:
            problem = _remaining_problem(plan.problem, start, state, belief, remaining)
        except GlissandoError:  # no admissible path begins at this state
            return Continuation(None, 0.0)
        search = Search(problem, _SHARE * remaining)
        new = _continued(search, plan, start, state[0])
        if new.risk <= remaining + 2.0 * new.risk_std:
            return Continuation(new, spent)
        still = np.repeat(state[0][:, None], new.evaluation.control.shape[1], axis=1)
        braked = _with_risk(*judged_closely(search, search.at(problem.space.follow(still))))
    reason = (
        f"Of what is left of the motion {100.0 * new.risk:.2g} % would hit, and "
        f"{100.0 * remaining:.2g} % are allowed; "
    )
    if braked.risk >= new.risk:
        return Continuation(new, spent, exceeded=f"{reason}to stop would be no safer.")
    reason += (
        f"the robot stops {start:.3g} s after its last plan began, where {100.0 * braked.risk:.2g} "
        f"% do."
    )
    return Continuation(braked, spent, reason)


def _continued(search: Search, plan: MotionPlan, start: float, values: Array) -> MotionPlan:
    """Rest of a plan from values (C,) of the actuators, improved until its risk is allowed."""
    space, planned = search.problem.space, MotionFollower(plan).planned
    ahead = planned(start + space.paths[0].control_times)
    motion = search.at(space.follow((ahead + values - planned(start)).T))
    search, motion = judged_closely(search, motion)
    for _ in range(_ROUNDS):
        motion = search.improve(motion.control, _ITERATIONS, restores=False)
        search, motion = judged_closely(search, motion)
        new = _with_risk(search, motion)
        if new.risk <= search.problem.scene.delta:
            break
    return new


def _with_risk(search: Search, motion: Evaluation) -> MotionPlan:
    problem = search.problem
    return MotionPlan(problem, motion, *sample_risk(problem, motion), problem.scene.delta)


def _remaining_problem(
    problem: MotionProblem, start: float, state: tuple[Array, Array], belief: ErrorBelief,
    allowed: float,
) -> MotionProblem:  # fmt: skip
    """Planning problem of the rest of a motion."""
    scene = problem.scene
    targets = [replace(t, time=t.time - start) for t in scene.targets if t.time > start]
    rest = replace(scene, targets=targets, horizon=scene.horizon - start, delta=allowed)
    space = motion_space(rest, problem.space.paths[0].step, *state)
    return replace(problem, scene=rest, belief=belief, space=space)
