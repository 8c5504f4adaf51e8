"""What planning 10 s ahead costs: paths of 100 steps, 10 arclength nodes, one thread.

Processor seconds, the least of some runs. Usage: plan.py [RUNS]
"""

import os
import sys
import time
from dataclasses import replace

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from glissando import BaseVariance, SeparablePrior, load_robot
from glissando.plan import Trace, Zone, foresee, judge_of, plan_greedily, plan_slide, track_of
from glissando.robot import robot_file
from glissando.simulate import load_bench

LENGTH, HORIZON = 0.7, 10.0
ZONES = [Zone((0.5, 0.6))]
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


def clocked(work):
    """Milliseconds of processor time, and what came of it."""
    begin = time.process_time()
    out = work()
    return 1e3 * (time.process_time() - begin), out


def costs(robot, stage):
    """Milliseconds: outlook, plan, both, one value, one gradient, the greedy path; numbers kept."""
    reach = LENGTH - stage.stroke, LENGTH
    ahead, outlook = clocked(lambda: foresee(robot, reach, HORIZON))
    ready, judge = clocked(lambda: judge_of(outlook, ZONES, Trace()))
    track = track_of(stage, LENGTH, LENGTH, HORIZON)
    planned, plan = clocked(lambda: plan_slide(judge, track, ZONES))
    value, _ = clocked(lambda: judge.value(plan.arclength))
    slope, _ = clocked(lambda: judge(plan.arclength))
    greedy, _ = clocked(lambda: plan_greedily(judge, track))
    both = ahead + ready + planned
    return [ahead + ready, planned, both, value, slope, greedy], outlook.rows.shape[-1] // 2


def main(runs=5):
    """Print a row a prior and a stage."""
    bench = load_bench(robot_file("sliding700"))
    table = Table("prior", "stroke (mm)", "numbers a node", "outlook (ms)", box=MARKDOWN)
    for heading in ("plan (ms)", "both (ms)", "a value (ms)", "a gradient (ms)", "greedy (ms)"):
        table.add_column(heading)
    for name, robot in (("separable", SEPARABLE), ("kinematic", KINEMATIC)):
        for stage in (bench.slide, bench.full_slide):
            found = [costs(robot, stage) for _ in range(runs)]
            least = np.min([f[0] for f in found], axis=0)
            stroke = f"{1e3 * stage.stroke:g}"
            table.add_row(
                name,
                stroke,
                str(found[0][1]),
                *(f"{x:.1f}" if x < 10 else f"{x:.0f}" for x in least),
            )
    Console(width=140).print(table)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:2]))
