"""Receding horizon: while a smoother runs, the next stretch of the path, again and again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from glissando.errors import GlissandoError
from glissando.online import FixedLag
from glissando.plan.judge import judge_of
from glissando.plan.known import Course
from glissando.plan.objectives import Objective, Trace
from glissando.plan.outlook import foresee
from glissando.plan.sensor import SlidingSensor
from glissando.plan.slide import Plan, plan_slide
from glissando.plan.track import Track
from glissando.plan.zones import Zone
from glissando.posterior import Posterior

_TRIED, _ITERATIONS = 3, 12  # less than a plan from nothing: the last one is a good start


@dataclass
class Replanner:
    """Where the sensor goes next, by what is known now: call `next` with the smoother.

    The `track` says what its slide can do, how far ahead to plan, and where the sensor is before
    the first plan. Zones are in absolute time and may move; `wear` weighs the mean square speed;
    `node_step` and `course` are those of `foresee`. Limits hold from one plan to the next: each
    begins where and as fast as the one before is then, and comes to rest on its slide in the end.
    """

    sensor: SlidingSensor
    track: Track
    zones: Sequence[Zone]
    objective: Objective = field(default_factory=Trace)
    wear: float = 0.0
    node_step: float | None = None
    course: Course | None = None
    plan: Plan | None = field(default=None, init=False)

    def next(self, known: FixedLag | Posterior) -> Plan:
        """The plan from the newest time on.

        If the slide cannot leave the last plan just there within its limits, that goes on. Raises
        GlissandoError when no zone counts in the time ahead.
        """
        track = self.track
        outlook = foresee(
            known, (track.lower, track.upper), track.steps * track.step, self.sensor,
            course=self.course, step=track.step, node_step=self.node_step,
        )  # fmt: skip
        zones = [zone for zone in self.zones if zone.during(outlook.start, outlook.last)]
        before = None
        if self.plan is not None:
            place, speed = (float(x) for x in self.plan.at(outlook.start))
            try:
                track = replace(track, start=place, start_speed=speed)
            except GlissandoError:
                return self.plan
            before = self.plan.at(outlook.start + track.control_times)[0]
        self.plan = plan_slide(
            judge_of(outlook, zones, self.objective), track, zones,
            wear=self.wear, before=before, tried=_TRIED, iterations=_ITERATIONS,
        )  # fmt: skip
        return self.plan
