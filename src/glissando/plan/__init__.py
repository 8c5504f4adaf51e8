"""Active sensing: where a sliding sensor should go so that a zone of the body is known best.

What a reading tells depends on where and when it is taken, not on what it says, so a path can be
judged before it is taken, its gradient by every place costs one backward pass, and the best path
within a stage's limits is found by descent.

>>> from glissando import load_robot
>>> from glissando.simulate import SlideLimits
>>> robot, zone = load_robot("sliding700"), Zone((0.55, 0.6))
>>> outlook = foresee(robot, reach=(0.64, 0.7), horizon=4.0)
>>> track = track_of(SlideLimits(0.06, 0.024, 0.1), upper=0.7, start=0.7, horizon=4.0)
>>> plan = plan_slide(judge_of(outlook, [zone], Trace()), track, [zone])
>>> bool(plan.value <= min(plan.starts.values()))
True
"""

from glissando.plan.ahead import Ahead
from glissando.plan.compare import Foretold, blind_paths, everywhere, foretell
from glissando.plan.design import Design, is_best, sweep
from glissando.plan.greedy import plan_greedily
from glissando.plan.judge import Judge, judge_of
from glissando.plan.known import Snapshot, snapshot
from glissando.plan.motions import (
    Reshaping,
    Together,
    choose_motion,
    course_of,
    draw_motions,
    plan_together,
)
from glissando.plan.objectives import Chance, LogDet, Objective, Trace, Worst, objective_named
from glissando.plan.outlook import Outlook, foresee
from glissando.plan.planners import Elsewhere
from glissando.plan.replan import Replanner
from glissando.plan.sensor import SlidingSensor, sliding_sensor
from glissando.plan.slide import Plan, plan_slide
from glissando.plan.track import Track, track_of
from glissando.plan.zones import Moving, Zone, read_zone

__all__ = [
    "Ahead",
    "Chance",
    "Design",
    "Elsewhere",
    "Foretold",
    "Judge",
    "LogDet",
    "Moving",
    "Objective",
    "Outlook",
    "Plan",
    "Replanner",
    "Reshaping",
    "SlidingSensor",
    "Snapshot",
    "Together",
    "Trace",
    "Track",
    "Worst",
    "Zone",
    "blind_paths",
    "choose_motion",
    "course_of",
    "draw_motions",
    "everywhere",
    "foresee",
    "foretell",
    "is_best",
    "judge_of",
    "objective_named",
    "plan_greedily",
    "plan_slide",
    "plan_together",
    "read_zone",
    "sliding_sensor",
    "snapshot",
    "sweep",
    "track_of",
]
