"""Receding horizon: while a plan is followed, what is left of it is planned again and again.

What readings say of the model error changes what is still to come: where it may pass, and where
the slides should be. Of the risk that is allowed, each part of the motion that was carried out has
spent its own; what is left of the motion may spend the rest. Where no motion on does, the robot
comes to rest, as fast as its actuators may stop.
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

_ITERATIONS = 5  # of the search: the plan that is followed is a good start
_ROUNDS = 2  # of those, where the first leads to nothing that may be followed
_SHARE = 0.9  # of the allowed risk that the search aims at
_LEAST_RISK = 1e-4  # that a rest may have, when more than all was spent
_BEFORE, _ROUNDING = 1e-3, 1e-6  # s
_SLOWER = 1.0 - 1e-6  # share of a speed, so that rounding does not break a limit
_SHORTEST = 2.0  # pieces of the plan's paths, below which what is left is not planned again


@dataclass
class MotionReplanner:
    """A loop's commands while the plan is made anew: what `MotionFollower` is for one plan.

    All times are from the start of the first plan, s.

    Attributes:
        plan: The first plan.
        every: Time between two plans, s.
        lead: How far ahead of the newest command a plan begins, s: longer than the planner takes.
        planner: Where plans are computed; by default in the caller's own thread.
        follower: What follows the newest plan.
        begun: When that plan begins.
        spent: Risk of what was carried out of the plans before it.
        stopped: Why the robot was brought to rest before its target; empty unless it was.
        exceeded: Why the newest plan risks more than is left; empty unless it does.
        plans: How many plans were taken over.
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
        """Values (C,) that all actuators should have come to by a time, m."""
        self._take_over()
        if self._due is None and time > self._next and not self.stopped:
            self._submit()
            self._take_over()
        return self.follower.command(time - self.begun)

    def at(self, time: ArrayLike) -> Array:
        """Values (…, C) of all actuators at times up to the newest command's, m."""
        return self.follower.at(np.asarray(time, dtype=float) - self.begun)

    def advance(self, time: float) -> None:
        """Let time pass without readings."""
        self.follower.advance(time - self.begun)

    def add(self, readings: Readings) -> None:
        """Take readings of a coil since the last command."""
        self.follower.add(readings.changed(time=readings.time - self.begun))

    def _submit(self) -> None:
        follower, problem = self.follower, self.follower.problem
        start = follower.due + _even(self.lead, problem.scene.correction)
        last = max(target.time for target in problem.scene.targets)
        if last - start < _SHORTEST * problem.space.paths[0].step:
            self._next = np.inf
            return
        speed = (follower.planned(start) - follower.planned(start - _BEFORE)) / _BEFORE
        allowed = self.plan.problem.scene.delta - self.spent
        belief = follower.belief.after(start - follower.time, problem.time_scale)
        values = follower.at(start)
        state = values, _slowed(problem.space.paths, values, speed)
        self.planner.submit(partial(continue_motion, follower.plan, start, state, belief, allowed))
        self._due, self._next = start, self.begun + start + self.every

    def _take_over(self) -> None:
        """Follow the plan that was asked for, from where it begins, if it is there in time."""
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


def _slowed(paths: Sequence[PathSpace], values: Array, speed: Array) -> Array:
    """Speeds (C,) no faster than paths can stop from values (C,), as commands end at a limit."""
    low, high, sharpest = np.array([[p.lower, p.upper, p.acceleration] for p in paths]).T
    room = np.where(speed > 0.0, high - values, values - low)
    fastest = _SLOWER * np.sqrt(2.0 * sharpest * np.maximum(room, 0.0))
    return np.clip(speed, -fastest, fastest)


def _even(time: float, correction: float) -> float:
    """The time of whole corrections that is no shorter."""
    return float(np.ceil(time / correction - _ROUNDING) * correction)


@dataclass(frozen=True)
class Continuation:
    """What `continue_motion` finds.

    Attributes:
        plan: The plan to follow on; the one that is followed already, unless given.
        spent: Risk of what was carried out of that one until then.
        stopped: Why it comes to rest before the target; empty unless it does.
        exceeded: Why it risks more than is left; empty unless it does.
    """

    plan: MotionPlan | None
    spent: float
    stopped: str = ""
    exceeded: str = ""


def continue_motion(
    plan: MotionPlan, start: float, state: tuple[Array, Array], belief: ErrorBelief,
    allowed: float,
) -> Continuation:  # fmt: skip
    """What is left of a motion, planned anew.

    Args:
        plan: The plan that is followed.
        start: When the rest begins, s from the plan's start.
        state: Values and speeds (C,) of all actuators then, m and m/s.
        belief: What is known of the model error then.
        allowed: Risk of all that was not carried out before this plan.
    """
    with one_thread():
        before = np.searchsorted(plan.problem.space.moments, start - _ROUNDING)
        spent = sample_risk(plan.problem, plan.evaluation, moments=int(before))[0]
        left = max(allowed - spent, _LEAST_RISK)
        try:
            problem = _rest(plan.problem, start, state, belief, left)
        except GlissandoError:  # the actuators cannot leave their paths just there
            return Continuation(None, 0.0)
        search = Search(problem, _SHARE * left)
        new = _moving_on(search, plan, start, state[0])
        if new.risk <= left + 2.0 * new.risk_std:
            return Continuation(new, spent)
        still = np.repeat(state[0][:, None], new.evaluation.control.shape[1], axis=1)
        braked = _with_risk(*judged_closely(search, search.at(problem.space.follow(still))))
    reason = (
        f"Of what is left of the motion {100.0 * new.risk:.2g} % would hit, and {100.0 * left:.2g} "
        f"% are allowed; "
    )
    if braked.risk >= new.risk:
        return Continuation(new, spent, exceeded=f"{reason}to stop would be no safer.")
    reason += (
        f"the robot stops {start:.3g} s after its last plan began, where {100.0 * braked.risk:.2g} "
        f"% do."
    )
    return Continuation(braked, spent, reason)


def _moving_on(search: Search, plan: MotionPlan, start: float, values: Array) -> MotionPlan:
    """The rest of a plan from values (C,) of the actuators, improved until it may be followed."""
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


def _rest(
    problem: MotionProblem, start: float, state: tuple[Array, Array], belief: ErrorBelief,
    allowed: float,
) -> MotionProblem:  # fmt: skip
    """The problem of what is left of a motion."""
    scene = problem.scene
    targets = [replace(t, time=t.time - start) for t in scene.targets if t.time > start]
    rest = replace(scene, targets=targets, horizon=scene.horizon - start, delta=allowed)
    space = motion_space(rest, problem.space.paths[0].step, *state)
    return replace(problem, scene=rest, belief=belief, space=space)
