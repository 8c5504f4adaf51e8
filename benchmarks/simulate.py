"""Time of static shapes and of motions in simulation, on one core.

Times are processor seconds of one thread in one process, with ratios to the first row. A motion
with inertia is evaluated at 1 kHz at seven places. Usage: simulate.py
"""

import os
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from rich.console import Console
from rich.table import Table

from glissando.io.shipped_robots import robot_file
from glissando.simulation import Loads, SlidePath, Wrench, load_bench, simulate_session, solve_shape
from glissando.simulation.dynamics.scenario_file import scenario_of


def shapes(count, friction, seed=0):
    """Solve shapes of the paper's robot under random tensions, gravity and tip load, from rest."""
    rng = np.random.default_rng(seed)
    bench = load_bench(robot_file("sliding700"))
    tendons = bench.tendons
    if not friction:
        tendons = [type(t)(t.offset, t.end) for t in tendons]
    for _ in range(count):
        tip = Wrench(bench.rod.length, rng.normal(0.0, 0.05, 3))
        solve_shape(bench.rod, tendons, Loads(rng.uniform(0, 20, 2), bench.gravity, [tip]))


def motion():
    """Simulate twenty seconds from C to S, with the sensors' readings."""
    bench = load_bench(robot_file("sliding700"))
    moved = bench.move(bench.shape("C-to-S"), bench.flaws, seed=1)
    path = SlidePath.oscillate(3, 0.06, bench.slide)
    simulate_session(bench, moved, path, seed=1)


def swing():
    """Simulate two seconds from C to S with inertia, and evaluate seven places every ms."""
    bench = load_bench(robot_file("sliding700"))
    actuation = bench.shape("C-to-S").lasting(2.0)
    moved = bench.move_dynamically(scenario_of(actuation), bench.flaws, 1, 2.0)
    moved.at(np.linspace(0.1, bench.rod.length, 7)[:, None], np.arange(0.0, 2.0, 1e-3))


def main():
    """Print the table."""
    cases = [
        ("static shapes", lambda: shapes(100, False), 100),
        ("static shapes with friction", lambda: shapes(100, True), 100),
        ("20 s from C to S, recorded", motion, 1),
        ("2 s from C to S with inertia, at 1 kHz", swing, 1),
    ]
    table = Table("what", "seconds each", "a second", "ratio", title="Simulation, one core")
    first = None
    for label, work, count in cases:
        work()
        start = time.process_time()
        work()
        each = (time.process_time() - start) / count
        first = first or each
        table.add_row(label, f"{each:.4f}", f"{1 / each:.1f}", f"{each / first:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
