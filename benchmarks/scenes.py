"""Motions among obstacles in foreign physics: whether the stated risk is true, and worth it.

    python benchmarks/scenes.py risk --robot arm.toml [--runs 100] [--scenes 5] [--delta 0.05]
    python benchmarks/scenes.py margin --robot arm.toml [--scenes 12]
    python benchmarks/scenes.py speed --robot arm.toml
    python benchmarks/scenes.py sensing --runs 30 [--scenes 5] [--figure FILE.png]

risk: motions are planned in random scenes and followed by robots drawn at random (see
`scenes_world.py`), which read their coil and correct. Hits are given with their 95 % binomial
interval, beside the largest risk that was allowed.
margin: the same scenes with one margin for every place, as large as makes the risk the same.
speed: what an evaluation with slopes and a replan from a warm start cost.
sensing: slide and motion planned together, against a slide that stays, that oscillates, or that
is planned after the motion, through slits that the body must take (see `scenes_sensing.py`).
Numbers of seeds below TUNED were used to set the physics and the example's [tendons].
"""

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import beta

from glissando import GlissandoError, load_robot
from glissando.errors import NoShapeError
from glissando.planning.scene.follow import MotionFollower
from glissando.planning.scene.motion_search import Search
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.scene_file import Actuator, Scene, Target
from glissando.planning.sliding_sensor import sliding_sensor
from scenes_margin import margin_rows
from scenes_sensing import draw_sensing, sensing_rows, summed
from scenes_world import PAUSE, World, run_loop

TUNED = 1000
HORIZON, RADIUS, BALL, TOLERANCE = 6.0, 0.005, 0.010, 0.006
MODEL_STD = 8e-4  # m: what robots of seeds below TUNED are off by that no model error explains
TENDON = {"lower": -1e-3, "upper": 6e-3, "speed": 1.2e-3, "acceleration": 1.5e-3}


def drawn_scene(robot, seed, delta):
    """A target, and a ball that the straight way to it would hit or graze, at a random side."""
    rng = np.random.default_rng([seed, 1])
    sensor = sliding_sensor(robot, rate=20.0)
    slide = Actuator(0.3 * robot.length, robot.length, 0.05, 0.1, 0.7 * robot.length)
    tendons = [Actuator(start=0.0, **TENDON)] * len(robot.tendons)
    scene = Scene([], [], RADIUS, delta, HORIZON, tendons, [slide], [sensor], model_std=MODEL_STD,
                  correction=PAUSE)  # fmt: skip
    body = motion_problem(replace(scene, targets=[Target(np.zeros(3), 1.0, HORIZON)]), robot).body
    angle = rng.uniform(0.0, 2.0 * np.pi)
    towards = np.cos(robot.tendons.angle - angle)
    pulled = np.clip(3.5e-3 * rng.uniform(0.7, 1.2) * towards, -5e-4, None)
    target = body.shapes(pulled[None]).place[0, -1]
    grazed = body.shapes(rng.uniform(0.35, 0.65) * pulled[None])
    n = int(rng.uniform(0.75, 1.0) * (body.arclength.size - 1))
    side = rng.standard_normal(3)
    tangent = grazed.pose[0, n, :3, 2]
    side -= (side @ tangent) * tangent
    away = side / np.linalg.norm(side) * rng.uniform(0.2, 0.9) * (RADIUS + BALL)
    ball = sphere(grazed.place[0, n] + away, BALL)
    return replace(scene, obstacles=[ball], targets=[Target(target, TOLERANCE, HORIZON)])


def plans_of(robot, deltas, count, first):
    """Plans (scenes, deltas) of random scenes in which the risk binds at all levels."""
    found, seed = [], first
    while len(found) < count and seed < first + 10 * count:
        try:
            row = [
                plan_motion(motion_problem(drawn_scene(robot, seed, d), robot),
                            candidates=3, iterations=40)
                for d in deltas
            ]  # fmt: skip
        except GlissandoError as problem:
            print(f"  scene {seed} left out: {str(problem)[:90]}", file=sys.stderr)
            row = []
        if row and all(plan.risk > 0.6 * d for plan, d in zip(row, deltas, strict=True)):
            found.append((seed, row))
        elif row:
            risks = [f"{100 * plan.risk:.2g}" for plan in row]
            print(f"  scene {seed} left out: risk {risks} % without effort", file=sys.stderr)
        seed += 1
    return found


def interval(hits, runs):
    """Clopper and Pearson's 95 % interval of a share."""
    low = beta.ppf(0.025, hits, runs - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, runs - hits) if hits < runs else 1.0
    return float(low), float(high)


def followed(plan, robot, seed, senses=True):
    """Least clearance and miss of a robot of a seed, m."""
    world = World.drawn(robot, plan.problem.scene, seed)
    try:
        return run_loop(MotionFollower(plan), world, senses)
    except NoShapeError:
        return -1.0, np.inf


def risk(robot, options):
    """Hits a level, over random scenes and robots."""
    deltas = options.delta or [0.01, 0.05, 0.1]
    found = plans_of(robot, deltas, options.scenes, options.first)
    rows, start = [], time.perf_counter()
    for level, delta in enumerate(deltas):
        hits, misses, clear = 0, [], []
        for k in range(options.runs):
            seed, plans = found[k % len(found)]
            clearance, miss = followed(plans[level], robot, options.first + 10_000 * seed + k)
            hits += clearance < 0.0
            misses.append(miss)
            clear.append(clearance)
            if time.perf_counter() - start > 10.0:
                print(f"  delta {delta:g}: {hits} of {k + 1}", file=sys.stderr, flush=True)
                start = time.perf_counter()
        low, high = interval(hits, options.runs)
        stated = float(np.mean([plans[level].risk for _, plans in found]))
        rows.append({"delta": delta, "runs": options.runs, "scenes": len(found), "stated": stated,
                     "hits": int(hits), "share": hits / options.runs, "low": low, "high": high,
                     "median_miss_mm": 1e3 * float(np.median(misses))})  # fmt: skip
    return rows


def speed(robot, options):
    """CPU seconds of a motion's value, its slopes, and a replan of 10 s from a warm start."""
    ((_, (plan,)),) = plans_of(robot, [0.05], 1, options.first)
    scene = replace(plan.problem.scene, horizon=10.0)
    scene = replace(scene, targets=[replace(scene.targets[0], time=10.0)])
    problem = motion_problem(scene, robot)
    warm = np.pad(plan.evaluation.control, ((0, 0), (0, 4)), mode="edge")
    plan = plan_motion(problem, candidates=1, warm_start=warm)
    at, values = plan.evaluation, plan.commands()[1]
    moved, before = values[20], values[18]
    later = motion_problem(scene, robot, start=moved, speed=(moved - before) / 0.1)
    target = np.concatenate([at.control[:, 1:], at.control[:, -1:]], axis=1)
    rows, start = [], later.space.follow(target)
    for name, work in (
        ("value", lambda: problem.evaluate(at.control)),
        ("slope of cost", lambda: problem.cost_gradient(problem.evaluate(at.control))),
        ("slope of risk", lambda: problem.log_risk_gradient(problem.evaluate(at.control))),
        (
            "replan, 5 iterations",
            lambda: Search(later, 0.045).improve(start, 5, restores=False),
        ),
    ):
        work()
        taken = []
        for _ in range(5):
            begin = time.process_time()
            work()
            taken.append(time.process_time() - begin)
        size = {"moments": problem.space.moments.size, "free numbers": problem.space.size}
        rows.append({"what": name, **size, "cpu_s": float(np.median(taken))})
    return rows


def margin(robot, options):
    """Stated risks against one margin of the same risk."""
    (delta,) = options.delta or [0.05]
    return margin_rows(robot, plans_of(robot, [delta], options.scenes, options.first), delta)


def sensing(robot, options):
    """What planning slide and motion together is worth."""
    rows = sensing_rows(robot, options.runs, options.scenes, options.first)
    if options.figure:
        draw_sensing(rows, options.runs, options.figure)
    return rows if options.json else summed(rows, options.runs)


COMMANDS = {"risk": risk, "margin": margin, "speed": speed, "sensing": sensing}
SLITS = Path(__file__).with_name("scenes_sensing.toml")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=COMMANDS)
    parser.add_argument("--robot", type=Path, help="needed but for sensing")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--delta", type=float, action="append")
    parser.add_argument("--first", type=int, default=TUNED, help="first seed")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--figure", type=Path, help="of sensing")
    options = parser.parse_args()
    if options.robot is None and options.what != "sensing":
        parser.error(f"{options.what} needs --robot")
    rows = COMMANDS[options.what](load_robot(options.robot or SLITS), options)
    if options.json:
        print(json.dumps(rows))
        return
    print(" | ".join(rows[0]))
    for row in rows:
        print(" | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))


if __name__ == "__main__":
    main()
