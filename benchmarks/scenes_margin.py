"""Risk shared out by where it counts, against one margin for every place, for `scenes.py`.

A planner that keeps the expected body a fixed margin away from everything plans the same scenes,
with one margin after another. The slides go as in the motion with a stated risk.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np

from glissando.errors import GlissandoError
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.sampled_risk import sample_risk

SHARP = 1e-4  # m, by which a margin is softened
MARGINS = 1.5e-3, 2e-3, 2.5e-3, 3e-3, 3.25e-3, 3.5e-3, 4e-3  # m


def with_margin(robot, plan, margin):
    """Risk, time, way and cost of the motion that keeps a margin; infinite where there is none.

    Its search has the same starts as that of the plan, and the plan itself besides.
    """
    scene = plan.problem.scene
    surely = replace(robot, tendons=replace(robot.tendons, std=1e-7, psd_moment=1e-14))
    wide = replace(
        scene, robot_radius=scene.robot_radius + margin, model_std=SHARP, delta=0.5, sensors=[],
        slides=[],
    )  # fmt: skip
    try:
        problem = motion_problem(wide, surely)
        warm = plan.evaluation.control[: len(scene.tendons)]
        keeping = plan_motion(problem, candidates=3, iterations=40, warm_start=warm)
    except GlissandoError:
        return np.full(4, np.inf)
    return judged(plan, keeping.evaluation.control)


def judged(plan, control):
    """Risk, seconds until the tip stays at its target, length of its way (m), and cost."""
    problem = plan.problem
    slides = plan.evaluation.control[len(problem.scene.tendons) :]
    at = problem.evaluate(np.concatenate([control[: len(problem.scene.tendons)], slides]))
    target = problem.scene.targets[-1]
    far = np.linalg.norm(at.tip - target.position, axis=1) > 1.05 * target.tolerance
    last = np.flatnonzero(far).max(initial=-1) + 1
    time = problem.space.moments[min(last, far.size - 1)]
    way = np.linalg.norm(np.diff(at.tip, axis=0), axis=1).sum()
    return np.array([sample_risk(problem, at)[0], time, way, at.cost])


def margin_rows(pool, robot, plans):
    """Motions with a stated risk, and those that keep each margin: risks, and ratios of both.

    Ratios are of sums over the scenes that a margin passes, ours over theirs, with their 95 %
    intervals over scenes drawn with replacement.
    """
    ours = np.array(pool.map(own, plans))
    rows, rng = [described("stated", ours, ours, rng=None)], np.random.default_rng(0)
    for margin in MARGINS:
        theirs = np.array(pool.map(partial(with_margin, robot, margin=margin), plans, 1))
        rows.append(described(f"{1e3 * margin:g} mm", ours, theirs, rng))
        print(f"  {rows[-1]}", file=sys.stderr, flush=True)
    return rows


def described(name, ours, theirs, rng):
    """One row: risks of their motions, and ratios of ours to theirs."""
    both = np.isfinite(theirs).all(axis=1)
    row = {"margin": name, "scenes": len(ours), "passed": int(both.sum())}
    if not both.any():
        return row
    row |= {"risk": float(theirs[both, 0].mean()), "worst": float(theirs[both, 0].max())}
    for k, what in enumerate(("time", "way", "cost"), start=1):
        a, b = ours[both, k], theirs[both, k]
        row[what] = float(a.sum() / b.sum())
        if rng:
            drawn = rng.integers(0, a.size, (2000, a.size))
            ratio = a[drawn].sum(axis=1) / b[drawn].sum(axis=1)
            row[what] = [row[what], *np.quantile(ratio, [0.025, 0.975]).tolist()]
        else:
            row[what] = float(a.mean())
    return row


def own(plan):
    """Risk, time, way and cost of a plan's own motion."""
    return judged(plan, plan.evaluation.control)
