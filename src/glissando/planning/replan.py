"""Receding horizon: while a smoother runs, the next stretch of the path, again and again.

A plan takes longer than an update. So it is made from a snapshot, begins where the path that is
being followed will be when it is ready, and is taken up if it comes in time.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError, PlanWarning
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.planning.belief import Belief, ExpectedMotion, belief_of
from glissando.planning.objectives import Objective, Trace
from glissando.planning.path_objective import judge_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planners import GoneError, InlinePlanner, Planner
from glissando.planning.planning_problem import predict_information
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.planning.zones import Zone

_TRIED, _ITERATIONS = 3, 12  # less than a plan from nothing: the last one is a good start
_NOW = 0.1  # of a time step of the estimate: what begins as soon begins at once
_LONGER, _SPARE = 2.0, 1.5  # what a late plan makes of the lead, and of the time that it took
_ROUNDING = 1e-9  # s


@dataclass(frozen=True)
class Route:
    """Plans that take over from each other, in order; at rest at `home` before the first."""

    home: float
    plans: tuple[Plan, ...] = ()

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…) and speed (…) at absolute times."""
        when = np.asarray(time, dtype=float)
        place, speed = np.full(when.shape, self.home), np.zeros(when.shape)
        for plan in self.plans:
            begun = when >= plan.start - _ROUNDING
            place, speed = (
                np.where(begun, new, old)
                for new, old in zip(plan.at(when), (place, speed), strict=True)
            )
        return place, speed

    def since(self, time: float) -> Route:
        """The part of it that counts from then on."""
        over = sum(plan.start <= time for plan in self.plans) - 1
        return replace(self, plans=self.plans[max(0, over) :])


@dataclass(frozen=True)
class Stretch:
    """All that the next plan is made from, small enough to hand over: call it for the plan.

    It begins at `start`, until when the sensor follows the `route`; the rest is a `Replanner`'s.
    """

    known: Belief
    route: Route
    start: float
    track: PathSpace
    sensor: SlidingSensor
    zones: Sequence[Zone]
    objective: Objective
    wear: float
    node_step: float | None
    course: ExpectedMotion | None

    def __call__(self) -> Plan:
        """The plan. Raises GlissandoError when no zone counts in the time ahead."""
        known, track = self.known, self.track
        if self.start - known.time > _NOW * known.node_step:
            known = known.later(self.start, self.sensor, self._place, self.course)
        outlook = predict_information(
            replace(known, time=self.start), (track.lower, track.upper), track.lasts,
            self.sensor, course=self.course, step=track.step, node_step=self.node_step,
        )  # fmt: skip
        zones = [zone for zone in self.zones if zone.during(outlook.start, outlook.last)]
        return plan_slide(
            judge_of(outlook, zones, self.objective), track, zones, wear=self.wear,
            before=self._place(self.start + track.control_times) if self.route.plans else None,
            tried=_TRIED, iterations=_ITERATIONS,
        )  # fmt: skip

    def _place(self, time: Array) -> Array:
        return self.route.at(time)[0]


@dataclass
class Replanner:
    """Where the sensor goes next, by what is known now: call `next` with the smoother.

    The `track` says what its slide can do, how far ahead to plan, and where the sensor is before
    the first plan. Zones are in absolute time and may move; `wear` weighs the mean square speed;
    `node_step` and `course` are those of `predict_information`. Each plan begins `lead` seconds
    ahead, where and as fast as the path is then that is followed till then: limits hold from one to
    the next, and each comes to rest on its slide in the end. It is made at once, or by
    `ProcessPlanner` if that is the `planner`; then `lead` is to be longer than that takes. What
    comes too late is not taken up, and makes it longer until plans come sooner again.
    """

    sensor: SlidingSensor
    track: PathSpace
    zones: Sequence[Zone]
    objective: Objective = field(default_factory=Trace)
    wear: float = 0.0
    node_step: float | None = None
    course: ExpectedMotion | None = None
    lead: float = 0.0
    planner: Planner = field(default_factory=InlinePlanner)
    route: Route = field(init=False)
    _due: float | None = field(default=None, init=False)
    _asked: float = field(default=0.0, init=False)
    _least: float = field(init=False)
    _gone: bool = field(default=False, init=False)
    _said: set[str] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        self.route, self._least = Route(self.track.start), self.lead

    @property
    def plan(self) -> Plan | None:
        """The newest plan, which may begin later."""
        return self.route.plans[-1] if self.route.plans else None

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…) and speed (…) of the path at absolute times, past and to come."""
        return self.route.at(time)

    def next(
        self, known: FixedLagSmoother | Posterior | Belief, now: float | None = None
    ) -> Plan | None:
        """Take up a plan that has come, ask for another if none is being made; the newest plan.

        The path up to `now` has been followed, the newest time that is known unless given, and
        stays as it is. Waits for nothing but a planner that is here. If there is no plan, or none
        in time, a PlanWarning says so once and the last one goes on.
        """
        if now is None:
            newest = known.grid.time[-1] if isinstance(known, Posterior) else known.time
            now = -np.inf if newest is None else float(newest)
        self._take(now)
        if self._due is None and not self._gone:
            self._ask(belief_of(known), now)
            self._take(now)
        return self.plan

    def _ask(self, known: Belief, now: float) -> None:
        start = max(now, known.time) + self.lead
        place, speed = (float(x) for x in self.route.at(start))
        try:
            track = replace(self.track, start=place, start_speed=speed)
        except GlissandoError:
            return  # the slide cannot leave its path just there within its limits
        self.planner.ask(
            Stretch(
                known, self.route.since(known.time), start, track, self.sensor, self.zones,
                self.objective, self.wear, self.node_step, self.course,
            )
        )  # fmt: skip
        self._due, self._asked = start, now

    def _take(self, now: float) -> None:
        if self._due is None:
            return
        late = now > self._due + _ROUNDING
        if late:
            self._say("late", f"A plan for {self._due:.3f} s was not there by then")
        try:
            plan = self.planner.answer()
        except GlissandoError as problem:
            self._due, self._gone = None, isinstance(problem, GoneError)
            self._say(type(problem).__name__, str(problem).rstrip("."))
            return
        if plan is None:
            return
        self._due = None
        longer = max(_SPARE * (now - self._asked), _LONGER * self.lead if late else self._least)
        self.lead = min(longer, max(self._least, 0.5 * self.track.lasts))
        if late:
            return
        kept = self.route.since(now - self.track.lasts)
        self.route = replace(kept, plans=(*kept.plans, plan))

    def _say(self, kind: str, what: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            goes_on = "the last one goes on" if self.plan else "the sensor stays where it is"
            warnings.warn(f"{what}; {goes_on}.", PlanWarning, stacklevel=4)
