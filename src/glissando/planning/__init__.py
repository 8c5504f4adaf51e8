"""Active sensing: paths of a sliding sensor that minimise the uncertainty of zones of the body.

The information of a reading depends on where and when it is taken, not on its value. A path can
therefore be evaluated in advance, its gradient costs one backward pass, and descent finds the best
path within the limits of a stage.

>>> from glissando import load_robot
>>> from glissando.simulation import SlideLimits
>>> robot, zone = load_robot("sliding700"), Zone((0.55, 0.6))
>>> problem = predict_information(robot, reach=(0.64, 0.7), horizon=4.0)
>>> path_space = path_space_of(SlideLimits(0.06, 0.024, 0.1), upper=0.7, start=0.7, horizon=4.0)
>>> plan = plan_slide(path_objective_of(problem, [zone], Trace()), path_space, [zone])
>>> bool(plan.value <= min(plan.starts.values()))
True
"""

from glissando.planning.candidates import Candidate, candidates_of
from glissando.planning.compare import (
    baseline_paths,
    best_evaluated,
    evaluate_everywhere,
    evaluate_path,
)
from glissando.planning.design import Design, pareto_front, sweep
from glissando.planning.motions import draw_motions, expected_motion, plan_jointly
from glissando.planning.objectives import Chance, LogDet, Trace, Worst
from glissando.planning.path_objective import path_objective_of
from glissando.planning.path_space import PathSpace, path_space_of
from glissando.planning.placement import Placement, place_sensors, placement_problem
from glissando.planning.plan_slide import plan_slide
from glissando.planning.planners import ProcessPlanner
from glissando.planning.planning_problem import predict_information
from glissando.planning.replan import Replanner
from glissando.planning.sliding_sensor import SlidingSensor, sliding_sensor
from glissando.planning.zones import MovingInterval, Zone

__all__ = [
    "Candidate",
    "Chance",
    "Design",
    "LogDet",
    "MovingInterval",
    "PathSpace",
    "Placement",
    "ProcessPlanner",
    "Replanner",
    "SlidingSensor",
    "Trace",
    "Worst",
    "Zone",
    "baseline_paths",
    "best_evaluated",
    "candidates_of",
    "draw_motions",
    "evaluate_everywhere",
    "evaluate_path",
    "expected_motion",
    "pareto_front",
    "path_objective_of",
    "path_space_of",
    "place_sensors",
    "placement_problem",
    "plan_jointly",
    "plan_slide",
    "predict_information",
    "sliding_sensor",
    "sweep",
]
