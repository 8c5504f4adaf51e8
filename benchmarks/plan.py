"""Write into docs/planning.md the cost of planning, and its effect on a running loop.

Usage: plan.py [RUNS [SECONDS]], SECONDS of each loop in each of RUNS rounds.
"""

import os
import sys
import time
import warnings
from dataclasses import replace
from datetime import date

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando import BaseVariance, FixedLagSmoother, SeparablePrior, load_robot
from glissando.errors import PlanWarning
from glissando.io.shipped_robots import robot_file
from glissando.planning import (
    ProcessPlanner,
    Replanner,
    Trace,
    Zone,
    evaluate_path,
    path_objective_of,
    path_space_of,
    plan_slide,
    predict_information,
    sliding_sensor,
)
from glissando.planning.plan_slide import starts
from glissando.simulation import load_bench
from plan_page import number, table, write

LENGTH, HORIZON = 0.7, 10.0
ZONES = [Zone((0.5, 0.6))]
TASKS = ZONES, [Zone((0.1, 0.2))], [Zone((0.3, 0.4), (0, 5)), Zone((0.6, 0.7), (5, 10))]
KINEMATIC = replace(
    load_robot("sliding700"), arclength_nodes=np.linspace(0.0, LENGTH, 10), sensor_parameters=()
)
SEPARABLE = replace(
    KINEMATIC,
    time_rate=1.0,
    prior=SeparablePrior(
        np.array([1e-4, 1e-4, 1e-4, 20, 20, 1.0]),
        4.0,
        BaseVariance(np.full(6, 1e-6), np.array([1e-4, 1e-4, 1e-4, 5, 5, 0.1])),
    ),
)
ROBOTS = {"separable": SEPARABLE, "kinematic": KINEMATIC}
TICK, LEAD = 0.1, 0.5  # s: period of the loop, and lead time of a plan


def clocked(work):
    """Milliseconds of processor time of a call, and its result."""
    begin = time.process_time()
    out = work()
    return 1e3 * (time.process_time() - begin), out


def costs(robot, stage):
    """Milliseconds of problem, plan, both, one value, one gradient; and the number of modes."""
    reach = LENGTH - stage.stroke, LENGTH
    predicting, problem = clocked(lambda: predict_information(robot, reach, HORIZON))
    preparing, path_objective = clocked(lambda: path_objective_of(problem, ZONES, Trace()))
    path_space = path_space_of(stage, LENGTH, LENGTH, HORIZON)
    planning, plan = clocked(lambda: plan_slide(path_objective, path_space, ZONES))
    value, _ = clocked(lambda: path_objective.value(plan.arclength))
    gradient, _ = clocked(lambda: path_objective(plan.arclength))
    before = predicting + preparing
    return [before, planning, before + planning, value, gradient], problem.rows.shape[-1] // 2


def error(robot, stage):
    """RMS and largest error (%) of the standard deviations by modes against those at full size."""
    problem = predict_information(robot, (LENGTH - stage.stroke, LENGTH), HORIZON)
    path_space, misses = path_space_of(stage, LENGTH, LENGTH, HORIZON), []
    for zones in TASKS:
        path_objective = path_objective_of(problem, zones, Trace())
        targets = np.stack(list(starts(path_space, zones, 0.0, 0).values())[::4])
        for control in path_space.follow(targets):
            path = path_space.arclength(control)
            whole = evaluate_path(problem, zones, Trace(), path).std
            misses.append(100.0 * (np.sqrt(path_objective.value(path)) / whole - 1.0))
    return np.sqrt(np.mean(np.square(misses))), np.abs(misses).max()


def cost_lines(runs):
    """Lines of the table of costs, with a row per prior and stage."""
    bench, rows = load_bench(robot_file("sliding700")), []
    for name, robot in ROBOTS.items():
        for stage in (bench.slide, bench.full_slide):
            times, (modes, *_) = zip(*(costs(robot, stage) for _ in range(runs)), strict=True)
            least = map(number, np.min(times, axis=0))
            missed = " / ".join(map(number, error(robot, stage)))
            rows.append([name, f"{1e3 * stage.stroke:g}", modes, *least, missed])
    heads = "prior", "stroke (mm)", "modes", "problem (ms)", "plan (ms)", "both (ms)"
    heads += "a value (ms)", "a gradient (ms)", "σ missed by (%)"
    return [
        f"`benchmarks/plan.py`, {date.today()}: {HORIZON:g} s ahead, paths of 100 steps, 10 "
        f"arclength nodes, 10 (separable) or 20 time steps; milliseconds of processor time on one "
        f"thread, the least of {runs} runs on a machine that others used as well. The last column "
        f"is the error of the modes' standard deviations against those at full size, root mean "
        f"square and largest, over starts for three tasks.",
        "",
        *table(heads, rows),
    ]


def loop(robot, stage, seconds, planner=None, lead=0.0):
    """Milliseconds (updates, 3) of updates by wall clock and thread time, and of `next` alone.

    Also returns the number of plans.
    """
    path_space = path_space_of(stage, LENGTH, LENGTH, 0.5 * HORIZON)
    options = {} if planner is None else {"planner": planner}
    sensor = sliding_sensor(robot)
    replanner = Replanner(sensor, path_space, ZONES, node_step=0.5, lead=lead, **options)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    out, plans, begin = [], set(), time.perf_counter()
    for tick in range(round(seconds / TICK)):
        now = tick * TICK
        time.sleep(max(0.0, begin + now - time.perf_counter()))
        times = now - TICK + TICK * np.arange(1, 5) / 4.0
        place = replanner.at(times)[0]
        pose = np.tile(np.eye(4), (4, 1, 1))
        pose[:, 2, 3] = place
        coil = sensor.readings(pose, place, times)
        clocks = [(time.perf_counter(), time.thread_time())]
        smoother.add(coil)
        smoother.advance(now)
        middle = time.thread_time()
        if planner is not None or lead:
            plans.add(id(replanner.next(smoother, time.perf_counter() - begin)))
        clocks.append((time.perf_counter(), time.thread_time()))
        (wall, own), (wall_end, own_end) = clocks
        out.append([wall_end - wall, own_end - own, own_end - middle])
    return 1e3 * np.array(out)[5:], len(plans)


def loop_lines(rounds, seconds):
    """Lines of the table of loops: without plans, with plans by a process, and inline."""
    stage, rows = load_bench(robot_file("sliding700")).full_slide, []
    warnings.simplefilter("ignore", PlanWarning)  # every plan is late here
    for name, robot in ROBOTS.items():
        runs_of = {"none": [], "by a process": [], "inline": []}
        with ProcessPlanner() as planner:
            for _ in range(rounds):
                runs_of["none"].append(loop(robot, stage, seconds))
                runs_of["by a process"].append(loop(robot, stage, seconds, planner, LEAD))
                if planner.ready(10.0):
                    planner.result()  # discard the plan that the last loop did not use
                runs_of["inline"].append(loop(robot, stage, 0.25 * seconds, lead=LEAD))
        alone = [times for times, _ in runs_of["none"]]
        alone = np.quantile(np.concatenate(alone), [0.5, 0.99], axis=0)
        for planned, runs in runs_of.items():
            times = np.concatenate([times for times, _ in runs])
            half, most = np.quantile(times, [0.5, 0.99], axis=0)
            rows.append([name, planned, len(times), sum(n for _, n in runs)])
            for clock in (0, 1):
                rows[-1] += [f"{number(half[clock])} / {number(most[clock])}"]
                ratios = half[clock] / alone[0, clock], most[clock] / alone[1, clock]
                rows[-1] += [" / ".join(f"{ratio:.2f}" for ratio in ratios)]
            last = f"{number(half[2])} / {number(most[2])}" if planned != "none" else ""
            rows[-1].append(last)
    heads = "prior", "plans computed", "updates", "plans", "by the clock (ms)", "× none"
    heads += "in the thread (ms)", "× none", "`next` (ms)"
    return [
        f"`benchmarks/plan.py`, {date.today()}: {1.0 / TICK:g} updates a second with 4 readings "
        f"each in real time, 10 arclength nodes, {0.5 * HORIZON:g} s ahead with a full stroke; "
        f"median / 99 % of what an update takes, all of it and its own thread's share, and what "
        f"`next` takes of the latter.",
        "",
        *table(heads, rows),
    ]


def main(runs=5, seconds=20.0):
    """Write both tables."""
    write("costs", cost_lines(int(runs)))
    write("loop", loop_lines(2, seconds))


if __name__ == "__main__":
    main(*(float(a) for a in sys.argv[1:3]))
