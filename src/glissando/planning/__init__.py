"""Active sensing: where a sliding sensor should go so that a zone of the body is known best.

What a reading tells depends on where and when it is taken, not on what it says, so a path can be
judged before it is taken, its gradient by every place costs one backward pass, and the best path
within a stage's limits is found by descent.

>>> from glissando import load_robot
>>> from glissando.simulation import SlideLimits
>>> robot, zone = load_robot("sliding700"), Zone((0.55, 0.6))
>>> outlook = predict_information(robot, reach=(0.64, 0.7), horizon=4.0)
>>> track = track_of(SlideLimits(0.06, 0.024, 0.1), upper=0.7, start=0.7, horizon=4.0)
>>> plan = plan_slide(judge_of(outlook, [zone], Trace()), track, [zone])
>>> bool(plan.value <= min(plan.starts.values()))
True
"""

from glissando.planning.belief import Belief, belief_of
from glissando.planning.compare import Foretold, baseline_paths, evaluate_path, everywhere
from glissando.planning.design import Design, pareto_front, sweep
from glissando.planning.greedy import plan_greedily
from glissando.planning.motions import (
    JointPlan,
    Reshaping,
    choose_motion,
    course_of,
    draw_motions,
    plan_together,
)
from glissando.planning.objectives import Chance, LogDet, Objective, Trace, Worst, objective_named
from glissando.planning.path_objective import PathObjective, judge_of
from glissando.planning.path_space import PathSpace, track_of
from glissando.planning.plan_slide import Plan, plan_slide
from glissando.planning.planners import ProcessPlanner
from glissando.planning.planning_problem import PlanningProblem, predict_information
from glissando.planning.prediction import PredictedInformation
from glissando.planning.replan import Replanner
from glissando.planning.sliding_sensor import SlidingSensor, sliding_sensor
from glissando.planning.zones import Moving, Zone, read_zone

__all__ = [
    "Belief",
    "Chance",
    "Design",
    "Foretold",
    "JointPlan",
    "LogDet",
    "Moving",
    "Objective",
    "PathObjective",
    "PathSpace",
    "Plan",
    "PlanningProblem",
    "PredictedInformation",
    "ProcessPlanner",
    "Replanner",
    "Reshaping",
    "SlidingSensor",
    "Trace",
    "Worst",
    "Zone",
    "baseline_paths",
    "belief_of",
    "choose_motion",
    "course_of",
    "draw_motions",
    "evaluate_path",
    "everywhere",
    "judge_of",
    "objective_named",
    "pareto_front",
    "plan_greedily",
    "plan_slide",
    "plan_together",
    "predict_information",
    "read_zone",
    "sliding_sensor",
    "sweep",
    "track_of",
]
