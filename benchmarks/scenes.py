"""Motions among obstacles with unmodelled physics: validity and cost of the stated risk.

    python benchmarks/scenes.py risk --robot arm.toml [--runs 100] [--scenes 5] [--delta 0.05]
        [--model-std 3e-4]
    python benchmarks/scenes.py margin --robot arm.toml [--scenes 12] [--balls 6] [--margin 3]
    python benchmarks/scenes.py speed --robot arm.toml
    python benchmarks/scenes.py sensing --runs 30 [--scenes 5] [--figure FILE.png]

risk: motions are planned in random scenes and followed by random robots (see `scenes_world.py`)
with feedback from their coil. The table has hits with their 95 % binomial interval, and the largest
risk allowed.
margin: the same scenes with a fixed margin of clearance, and with the margin of equal risk in each.
speed: processor time of an evaluation with gradient, and of a replan from a warm start.
sensing: slide and motion planned jointly, against a slide that is fixed, that oscillates, or that
is planned after the motion, through slits that the body must pass (see `scenes_sensing.py`).
Seeds below TUNED were used to set the physics and the example's [tendons].
"""

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from scipy.stats import beta

from glissando import GlissandoError, load_robot
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.follow import MotionFollower
from glissando.planning.scene.obstacles import sphere
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.replan_motion import continue_motion
from glissando.planning.scene.scene import Actuator, Scene, Target
from glissando.planning.sliding_sensor import sliding_sensor
from scenes_margin import margin_rows
from scenes_sensing import draw_sensing, scene_rows, summed
from scenes_world import PAUSE, followed

TUNED = 1000
HORIZON, RADIUS, BALL, TOLERANCE = 6.0, 0.005, 0.010, 0.006
NEAR = 0.4  # largest distance of further balls from contact, over ball plus robot radius
CLEAR = 4e-3  # m: least distance of a further ball from the robot at the start
MODEL_STD = 3e-4  # m: robots of seeds below TUNED pass with both 2e-4 and 4e-4
TENDON = {"lower": -1e-3, "upper": 6e-3, "speed": 2.4e-3, "acceleration": 1.5e-3}


def drawn_scene(robot, seed, delta, balls, model_std):
    """Scene with a target, and balls beside the direct motion to it.

    The direct motion hits or grazes the first ball, at a random side; the other balls are up to
    `NEAR` radii beside it.
    """
    rng = np.random.default_rng([seed, 1])
    sensor = sliding_sensor(robot, rate=20.0)
    slide = Actuator(0.3 * robot.length, robot.length, 0.05, 0.1, 0.7 * robot.length)
    tendons = [Actuator(start=0.0, **TENDON)] * len(robot.tendons)
    scene = Scene([], [], RADIUS, delta, HORIZON, tendons, [slide], [sensor], model_std=model_std,
                  correction=PAUSE)  # fmt: skip
    body = motion_problem(replace(scene, targets=[Target(np.zeros(3), 1.0, HORIZON)]), robot).body
    angle = rng.uniform(0.0, 2.0 * np.pi)
    towards = np.cos(robot.tendons.angle - angle)
    pulled = np.clip(3.5e-3 * rng.uniform(0.7, 1.2) * towards, -5e-4, None)
    target = body.shapes(pulled[None]).place[0, -1]
    start, obstacles = body.shapes(np.zeros((1, pulled.size))).place[0], []
    while len(obstacles) < balls:
        grazes = not obstacles
        share = rng.uniform(*((0.35, 0.65) if grazes else (0.3, 1.0)))
        grazed = body.shapes(share * pulled[None])
        n = int(rng.uniform(0.75 if grazes else 0.3, 1.0) * (body.arclength.size - 1))
        side = rng.standard_normal(3)
        tangent = grazed.pose[0, n, :3, 2]
        side -= (side @ tangent) * tangent
        near = rng.uniform(*((0.2, 0.9) if grazes else (1.0, 1.0 + NEAR)))
        away = side / np.linalg.norm(side) * near * (RADIUS + BALL)
        ball = sphere(grazed.place[0, n] + away, BALL)
        if grazes or ball.distance(start)[0].min() > RADIUS + CLEAR:
            obstacles.append(ball)
    return replace(scene, obstacles=obstacles, targets=[Target(target, TOLERANCE, HORIZON)])


def binding(robot, deltas, options, seed):
    """Plans of a scene at all levels of risk; None unless the bound is active at each level."""
    try:
        scenes = [drawn_scene(robot, seed, d, options.balls, options.model_std) for d in deltas]
        plans = [
            plan_motion(motion_problem(scene, robot), candidates=3, iterations=40)
            for scene in scenes
        ]
    except GlissandoError as problem:
        print(f"  scene {seed} left out: {str(problem)[:90]}", file=sys.stderr, flush=True)
        return None
    if all(plan.risk > 0.6 * d for plan, d in zip(plans, deltas, strict=True)):
        return plans
    risks = [f"{100 * plan.risk:.2g}" for plan in plans]
    print(f"  scene {seed} left out: risk {risks} % without effort", file=sys.stderr, flush=True)
    return None


def plans_of(pool, robot, deltas, options):
    """Seeds and plans by level, of the first random scenes whose bounds on risk are active."""
    found, seed = [], options.first
    while len(found) < options.scenes and seed < options.first + 10 * options.scenes:
        seeds = range(seed, seed + options.processes)
        rows = pool.map(partial(binding, robot, deltas, options), seeds, 1)
        found += [(s, plans) for s, plans in zip(seeds, rows, strict=True) if plans]
        seed = seeds.stop
    return found[: options.scenes]


def interval(hits, runs):
    """Clopper–Pearson 95 % interval of a share."""
    low = beta.ppf(0.025, hits, runs - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, runs - hits) if hits < runs else 1.0
    return float(low), float(high)


def runs_of(task):
    """Least clearance and miss (m) of each robot of a task (robot, plan, seeds)."""
    robot, plan, seeds = task
    return [followed(plan, robot, seed) for seed in seeds]


def risk(pool, robot, options):
    """Rows of hits by level of risk, over random scenes and robots."""
    deltas = options.delta or [0.01, 0.05, 0.1]
    found, rows = plans_of(pool, robot, deltas, options), []
    for level, delta in enumerate(deltas):
        tasks = []
        for k, (seed, plans) in enumerate(found):
            robots = range(k, options.runs, len(found))
            seeds = [options.first + 10_000 * seed + n for n in robots]
            tasks += [(robot, plans[level], seeds[n : n + 10]) for n in range(0, len(seeds), 10)]
        ended = []
        for part in pool.imap_unordered(runs_of, tasks):
            ended += part
            hits = sum(clearance < 0.0 for clearance, _ in ended)
            print(f"  delta {delta:g}: {hits} of {len(ended)}", file=sys.stderr, flush=True)
        low, high = interval(hits, options.runs)
        stated = float(np.mean([plans[level].risk for _, plans in found]))
        miss = 1e3 * float(np.median([miss for _, miss in ended]))
        rows.append({"delta": delta, "runs": options.runs, "scenes": len(found), "stated": stated,
                     "hits": int(hits), "share": hits / options.runs, "low": low, "high": high,
                     "median_miss_mm": miss})  # fmt: skip
    return rows


def speed(pool, robot, options):
    """CPU seconds of a motion's value, its gradient, and a replan of 10 s from a warm start.

    The belief of the model error at the replan is the one that the plan predicted.
    """
    options.scenes = 1
    ((_, (plan,)),) = plans_of(pool, robot, [0.05], options)
    scene = replace(plan.problem.scene, horizon=10.0)
    scene = replace(scene, targets=[replace(scene.targets[0], time=10.0)])
    problem = motion_problem(scene, robot)
    warm = np.pad(plan.evaluation.control, ((0, 0), (0, 4)), mode="edge")
    plan = plan_motion(problem, candidates=1, warm_start=warm)
    at, planned = plan.evaluation, MotionFollower(plan).planned
    values, speeds = planned(1.0), (planned(1.0) - planned(0.999)) / 1e-3
    problem = plan.problem
    foreseen = at.known.corrections.before[round(1.0 / problem.space.correction)]
    belief = ErrorBelief(problem.belief.mean, foreseen)
    rows = []
    for name, work in (
        ("value", lambda: problem.evaluate(at.control)),
        ("value and slopes", lambda: problem.gradients(problem.evaluate(at.control))),
        ("replan", lambda: continue_motion(plan, 1.0, (values, speeds), belief, 0.05)),
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


def margin(pool, robot, options):
    """Rows that compare stated risks with fixed margins."""
    (delta,) = options.delta or [0.05]
    seeded = [(seed, plan) for seed, (plan,) in plans_of(pool, robot, [delta], options)]
    return margin_rows(pool, robot, seeded, options)


def sensing(pool, robot, options):
    """Rows that compare joint planning of slide and motion with other policies."""
    seeds = range(options.first, options.first + options.scenes)
    scenes = pool.map(partial(scene_rows, robot, runs=options.runs), seeds, 1)
    rows = [row for scene in scenes for row in scene]
    if options.figure:
        draw_sensing(rows, options.runs, options.figure)
    return rows if options.json else summed(rows, options.runs)


def millimetres(text):
    """Text of a margin in mm or "equal", checked for argparse."""
    return text if text == "equal" else f"{float(text):g}"


COMMANDS = {"risk": risk, "margin": margin, "speed": speed, "sensing": sensing}
SLITS = Path(__file__).with_name("scenes_sensing.toml")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=COMMANDS)
    parser.add_argument("--robot", type=Path, help="needed but for sensing")
    parser.add_argument("--runs", type=int, default=100, help="a level; of margin, a scene")
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--delta", type=float, action="append")
    parser.add_argument("--first", type=int, default=TUNED, help="first seed")
    parser.add_argument(
        "--margin", type=millimetres, action="append", help="mm, or `equal`: that of equal risk"
    )
    parser.add_argument("--balls", type=int, default=1, help="of a scene of risk and margin")
    parser.add_argument(
        "--model-std", type=float, default=MODEL_STD, help="m that no model error explains"
    )
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--figure", type=Path, help="of sensing")
    options = parser.parse_args()
    if options.robot is None and options.what != "sensing":
        parser.error(f"{options.what} needs --robot")
    with get_context("spawn").Pool(options.processes) as pool:
        rows = COMMANDS[options.what](pool, load_robot(options.robot or SLITS), options)
    if options.json:
        print(json.dumps(rows))
        return
    print(" | ".join(rows[0]))
    for row in rows:
        print(" | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))


if __name__ == "__main__":
    main()
