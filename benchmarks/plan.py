"""Write into docs/planning.md what planning costs, and what it does to a loop that is running.

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

from glissando import BaseVariance, CoilReadings, FixedLagSmoother, SeparablePrior, load_robot
from glissando.errors import PlanWarning
from glissando.io.robot_file import robot_file
from glissando.planning import (
    ProcessPlanner,
    Replanner,
    Trace,
    Zone,
    evaluate_path,
    judge_of,
    plan_greedily,
    plan_slide,
    predict_information,
    sliding_sensor,
    track_of,
)
from glissando.planning.plan_slide import starts
from glissando.simulation import load_bench
from plan_page import number, table, write

LENGTH, HORIZON = 0.7, 10.0
ZONES = [Zone((0.5, 0.6))]
JUDGED = ZONES, [Zone((0.1, 0.2))], [Zone((0.3, 0.4), (0, 5)), Zone((0.6, 0.7), (5, 10))]
KINEMATIC = replace(load_robot("sliding700"), arclength_nodes=np.linspace(0.0, LENGTH, 10))
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
TICK, LEAD = 0.1, 0.5  # s between updates of the loop, and that a plan begins ahead


def clocked(work):
    """Milliseconds of processor time, and what came of it."""
    begin = time.process_time()
    out = work()
    return 1e3 * (time.process_time() - begin), out


def costs(robot, stage):
    """Milliseconds: outlook, plan, both, one value, one gradient, the greedy path; numbers kept."""
    reach = LENGTH - stage.stroke, LENGTH
    ahead, outlook = clocked(lambda: predict_information(robot, reach, HORIZON))
    ready, judge = clocked(lambda: judge_of(outlook, ZONES, Trace()))
    track = track_of(stage, LENGTH, LENGTH, HORIZON)
    planned, plan = clocked(lambda: plan_slide(judge, track, ZONES))
    value, _ = clocked(lambda: judge.value(plan.arclength))
    slope, _ = clocked(lambda: judge(plan.arclength))
    greedy, _ = clocked(lambda: plan_greedily(judge, track))
    both = ahead + ready + planned
    return [ahead + ready, planned, both, value, slope, greedy], outlook.rows.shape[-1] // 2


def error(robot, stage):
    """Per cent by which deviations that plans are judged by miss those at full size: RMS, most."""
    outlook = predict_information(robot, (LENGTH - stage.stroke, LENGTH), HORIZON)
    track, misses = track_of(stage, LENGTH, LENGTH, HORIZON), []
    for zones in JUDGED:
        judge = judge_of(outlook, zones, Trace())
        paths = np.stack(list(starts(track, zones, 0.0, 0).values())[::4])
        for control in track.follow(paths):
            path = track.places(control)
            whole = evaluate_path(outlook, zones, Trace(), path).std
            misses.append(100.0 * (np.sqrt(judge.value(path)) / whole - 1.0))
    return np.sqrt(np.mean(np.square(misses))), np.abs(misses).max()


def cost_lines(runs):
    """A row a prior and a stage."""
    bench, rows = load_bench(robot_file("sliding700")), []
    for name, robot in ROBOTS.items():
        for stage in (bench.slide, bench.full_slide):
            found = [costs(robot, stage) for _ in range(runs)]
            least = np.min([f[0] for f in found], axis=0)
            missed = " / ".join(map(number, error(robot, stage)))
            rows.append([name, f"{1e3 * stage.stroke:g}", found[0][1], *map(number, least), missed])
    heads = "prior", "stroke (mm)", "numbers a node", "outlook (ms)", "plan (ms)", "both (ms)"
    heads += "a value (ms)", "a gradient (ms)", "greedy (ms)", "σ missed by (%)"
    return [
        f"`benchmarks/plan.py`, {date.today()}: {HORIZON:g} s ahead, paths of 100 steps, 10 "
        f"arclength nodes, 10 (separable) or 20 time steps; milliseconds of processor time on one "
        f"thread, the least of {runs} runs on a machine that others used as well. The last column "
        f"is by how much the deviations that paths are judged by miss those at full size, root "
        f"mean square and most, over starts for three tasks.",
        "",
        *table(heads, rows),
    ]


def loop(robot, stage, seconds, planner=None, lead=0.0):
    """Milliseconds (updates, 3) of updates by the clock, in the thread, and of `next` alone."""
    track = track_of(stage, LENGTH, LENGTH, 0.5 * HORIZON)
    given = {} if planner is None else {"planner": planner}
    sensor = sliding_sensor(robot)
    replanner = Replanner(sensor, track, ZONES, node_step=0.5, lead=lead, **given)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=4)
    out, plans, begin = [], set(), time.perf_counter()
    for tick in range(round(seconds / TICK)):
        now = tick * TICK
        time.sleep(max(0.0, begin + now - time.perf_counter()))
        taken = now - TICK + TICK * np.arange(1, 5) / 4.0
        place = replanner.at(taken)[0]
        seen = np.tile(np.eye(4), (4, 1, 1))
        seen[:, 2, 3] = place
        coil = CoilReadings(time=taken, arclength=place, values=seen, cov=sensor.cov, name="coil")
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
    """Three loops in turn: one that does not plan, one whose plans are made elsewhere, or in it."""
    stage, rows = load_bench(robot_file("sliding700")).full_slide, []
    warnings.simplefilter("ignore", PlanWarning)  # here, each plan is late
    for name, robot in ROBOTS.items():
        found = {"none": [], "elsewhere": [], "in the loop": []}
        with ProcessPlanner() as planner:
            for _ in range(rounds):
                found["none"].append(loop(robot, stage, seconds))
                found["elsewhere"].append(loop(robot, stage, seconds, planner, LEAD))
                if planner.ready(10.0):
                    planner.answer()  # what the last loop did not wait for
                found["in the loop"].append(loop(robot, stage, 0.25 * seconds, lead=LEAD))
        alone = np.quantile(np.concatenate([f for f, _ in found["none"]]), [0.5, 0.99], axis=0)
        for planned, runs in found.items():
            times = np.concatenate([f for f, _ in runs])
            half, most = np.quantile(times, [0.5, 0.99], axis=0)
            rows.append([name, planned, len(times), sum(n for _, n in runs)])
            for clock in (0, 1):
                rows[-1] += [f"{number(half[clock])} / {number(most[clock])}"]
                ratios = half[clock] / alone[0, clock], most[clock] / alone[1, clock]
                rows[-1] += [" / ".join(f"{ratio:.2f}" for ratio in ratios)]
            last = f"{number(half[2])} / {number(most[2])}" if planned != "none" else ""
            rows[-1].append(last)
    heads = "prior", "plans are made", "updates", "plans", "by the clock (ms)", "× none"
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
    """Both tables."""
    write("costs", cost_lines(int(runs)))
    write("loop", loop_lines(2, seconds))


if __name__ == "__main__":
    main(*(float(a) for a in sys.argv[1:3]))
