"""Receding-horizon planning: while a smoother runs, replan the next part of the path repeatedly.

A plan takes longer than an update. It is therefore computed from a belief, begins where the current
path will be when the new plan is ready, and is adopted if it is ready in time.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError, PlanWarning
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.given import require_kind, require_list
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.planning.belief import Belief, ExpectedMotion, belief_of
from glissando.planning.objectives import Objective, Trace, require_objective
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import PathSpace
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planners import InlinePlanner, Planner, PlannerExitedError
from glissando.planning.planning_problem import predict_information
from glissando.planning.sliding_sensor import SlidingSensor
from glissando.planning.zones import Zone

_CANDIDATES, _ITERATIONS = 3, 12  # fewer than for a first plan: the last plan is a good start
_NOW = 0.1  # share of a time step of the estimate, below which a belief is not propagated
_LONGER, _SPARE = (
    2.0,
    1.5,
)  # factors of the lead after a late plan: on the old lead, on the time taken
_ROUNDING = 1e-9  # s


@dataclass(frozen=True)
class Route:
    """A sequence of plans, each replacing the previous one from its start on.

    Attributes:
        home: Arclength at which the sensor rests before the first plan, m.
        plans: The plans in order of their start times.
    """

    home: float
    plans: tuple[Plan, ...] = ()

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…), m, and speed (…), m/s, at absolute times (…), s."""
        when = np.asarray(time, dtype=float)
        motion = np.full(when.shape, self.home), np.zeros(when.shape)
        for plan in self.plans:
            begun = when >= plan.start - _ROUNDING
            place, speed = plan.at(when)
            motion = np.where(begun, place, motion[0]), np.where(begun, speed, motion[1])
        return motion

    def since(self, time: float) -> Route:
        """The part of the route that is needed from an absolute time on, s."""
        over = sum(plan.start <= time for plan in self.plans) - 1
        return replace(self, plans=self.plans[max(0, over) :])


@dataclass
class Replanner:
    """Replans a sensor's path after each update of a smoother: call `next` with the smoother.

    Each plan begins `lead` seconds ahead, with the arclength and speed that the current path has
    then, so that limits hold across plans, and each plan ends at rest on the slide. A plan that is
    ready too late is not adopted; the lead is then increased until plans are ready in time again.

    Attributes:
        sensor: The sliding sensor.
        path_space: Paths of the slide: duration, limits, and the arclength before the first plan.
        zones: Zones in absolute time, which may move.
        objective: Objective over the zones.
        speed_weight: Weight of the mean square speed, as `plan_slide` takes it.
        node_step: Approximate time between nodes, s, as `predict_information` takes it.
        motion: Expected motion of the robot; by default it holds its newest shape.
        lead: Time ahead at which a plan begins, s; at least the computing time of the `planner`.
        planner: Computes the plans; by default in the caller's own thread.
        route: The plans adopted so far.
    """

    sensor: SlidingSensor
    path_space: PathSpace
    zones: Sequence[Zone]
    objective: Objective = field(default_factory=Trace)
    speed_weight: float = 0.0
    node_step: float | None = None
    motion: ExpectedMotion | None = None
    lead: float = 0.0
    planner: Planner[Plan] = field(default_factory=InlinePlanner)
    route: Route = field(init=False)
    _due: float | None = field(default=None, init=False)
    _submitted: float = field(default=0.0, init=False)
    _least_lead: float = field(init=False)
    _exited: bool = field(default=False, init=False)
    _warned: set[str] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        require_kind(self.sensor, SlidingSensor, "sensor", "give sliding_sensor(robot)")
        require_kind(self.path_space, PathSpace, "path space", "give path_space_of(…)")
        require_list(self.zones, Zone, "zones")
        require_objective(self.objective, np.inf)
        self.route, self._least_lead = Route(self.path_space.start), self.lead

    @property
    def plan(self) -> Plan | None:
        """The newest plan, which may begin in the future; None before the first."""
        return self.route.plans[-1] if self.route.plans else None

    def at(self, time: ArrayLike) -> tuple[Array, Array]:
        """Arclength (…), m, and speed (…), m/s, at absolute times (…), s, past or future."""
        return self.route.at(time)

    def next(
        self, source: FixedLagSmoother | Posterior | Belief, now: float | None = None
    ) -> Plan | None:
        """Adopt a plan that is ready, submit the next task, and return the newest plan.

        If planning fails or is late, the last plan is followed on, and a PlanWarning is issued once
        for each kind of failure.

        Args:
            source: The newest estimate.
            now: Time up to which the path has been followed, s; by default that of the estimate.

        Returns:
            The newest plan adopted; None before the first.
        """
        if now is None:
            newest = source.grid.time[-1] if isinstance(source, Posterior) else source.time
            now = -np.inf if newest is None else float(newest)
        self._adopt(now)
        if self._due is None and not self._exited:
            self._submit(belief_of(source), now)
            self._adopt(now)
        return self.plan

    def _submit(self, belief: Belief, now: float) -> None:
        start = max(now, belief.time) + self.lead
        place, speed = (float(x) for x in self.route.at(start))
        try:
            path_space = replace(self.path_space, start=place, start_speed=speed)
        except GlissandoError:
            return  # no admissible path begins at this place and speed; try again at the next call
        task = partial(
            _next_plan, belief, self.route.since(belief.time), start, path_space, self.sensor,
            self.zones, self.objective, self.speed_weight, self.node_step, self.motion,
        )  # fmt: skip
        self.planner.submit(task)
        self._due, self._submitted = start, now

    def _adopt(self, now: float) -> None:
        if self._due is None:
            return
        late = now > self._due + _ROUNDING
        if late:
            self._warn("late", f"A plan for {self._due:.3f} s was not there by then")
        try:
            plan = self.planner.result()
        except GlissandoError as problem:
            self._due, self._exited = None, isinstance(problem, PlannerExitedError)
            self._warn(type(problem).__name__, str(problem).rstrip("."))
            return
        if plan is None:
            return
        self._due = None
        least = _LONGER * self.lead if late else self._least_lead
        lead = max(_SPARE * (now - self._submitted), least)
        self.lead = min(lead, max(self._least_lead, 0.5 * self.path_space.duration))
        if not late:
            recent = self.route.since(now - self.path_space.duration)
            self.route = replace(recent, plans=(*recent.plans, plan))

    def _warn(self, kind: str, what: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            goes_on = "the last one goes on" if self.plan else "the sensor stays where it is"
            warnings.warn(f"{what}; {goes_on}.", PlanWarning, stacklevel=4)


def _next_plan(
    belief: Belief, route: Route, start: float, space: PathSpace, sensor: SlidingSensor,
    zones: Sequence[Zone], objective: Objective, speed_weight: float, node_step: float | None,
    motion: ExpectedMotion | None,
) -> Plan:  # fmt: skip
    """Compute the plan that begins at `start`, s; before that the sensor follows the route."""

    def place(time: Array) -> Array:
        return route.at(time)[0]

    if start - belief.time > _NOW * belief.node_step:
        belief = belief.propagate(start, sensor, place, motion)
    problem = predict_information(
        replace(belief, time=start), (space.lower, space.upper), space.duration, sensor,
        motion=motion, step=space.step, node_step=node_step,
    )  # fmt: skip
    zones = [zone for zone in zones if zone.overlap(problem.start, problem.end)]
    return plan_slide(
        path_objective_of(problem, zones, objective), space, zones,
        speed_weight=speed_weight, candidates=_CANDIDATES, iterations=_ITERATIONS,
        warm_start=place(start + space.control_times) if route.plans else None,
    )  # fmt: skip
