"""Risk shared out by where it counts, against one margin for every place, for `scenes.py`.

A planner that keeps the expected body a fixed margin away from everything plans the same scenes;
its margin is the one with which its motions are as risky, on average, as those with a stated risk.
"""

import sys
from dataclasses import replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.sampled_risk import sample_risk

SHARP = 1e-4  # m, by which a margin is softened
WIDEST = 6e-3  # m
HALVINGS = 5


def with_margin(scene, robot, margin):
    """The motion (C, S+2) that keeps a margin, or nothing where there is none."""
    surely = replace(robot, tendons=replace(robot.tendons, std=1e-7, psd_moment=1e-14))
    wide = replace(
        scene, robot_radius=scene.robot_radius + margin, model_std=SHARP, delta=0.5, sensors=[],
        slides=[],
    )  # fmt: skip
    try:
        plan = plan_motion(motion_problem(wide, surely), candidates=3, iterations=40)
    except GlissandoError:
        return None
    return plan.evaluation.control


def judged(plan, control):
    """Risk, seconds until the tip stays at its target, and length of its way, m, of a motion."""
    problem = plan.problem
    if control is None:
        return np.array([0.0, np.inf, np.inf])
    slides = plan.evaluation.control[len(problem.scene.tendons) :]
    at = problem.evaluate(np.concatenate([control[: len(problem.scene.tendons)], slides]))
    target = problem.scene.targets[-1]
    far = np.linalg.norm(at.tip - target.position, axis=1) > 1.05 * target.tolerance
    last = np.flatnonzero(far).max(initial=-1) + 1
    time = problem.space.moments[min(last, far.size - 1)]
    way = np.linalg.norm(np.diff(at.tip, axis=0), axis=1).sum()
    return np.array([sample_risk(problem, at)[0], time, way])


def margin_rows(robot, found, delta):
    """Risk, time and way of motions with a stated risk and with the margin of the same risk."""
    ours = np.array([judged(plan, plan.evaluation.control) for _, (plan,) in found])
    low, high = 0.0, WIDEST
    for _ in range(HALVINGS):
        margin = 0.5 * (low + high)
        theirs = np.array(
            [judged(plan, with_margin(plan.problem.scene, robot, margin)) for _, (plan,) in found]
        )
        risk = float(theirs[:, 0].mean())
        print(
            f"  margin {1e3 * margin:.2f} mm: risk {100 * risk:.2f} %", file=sys.stderr, flush=True
        )
        low, high = (margin, high) if risk > ours[:, 0].mean() else (low, margin)
    rng, both = np.random.default_rng(0), np.isfinite(theirs).all(axis=1)
    drawn = rng.integers(0, both.sum(), (2000, both.sum()))
    rows = []
    for name, k in (("time to the target", 1), ("way of the tip", 2)):
        a, b = ours[both, k], theirs[both, k]
        ratio = a[drawn].mean(axis=1) / b[drawn].mean(axis=1)
        rows.append({"what": name, "delta": delta, "scenes": len(found), "passed": int(both.sum()),
                     "margin_mm": 1e3 * margin, "risk": float(ours[:, 0].mean()),
                     "risk_of_margin": float(theirs[:, 0].mean()),
                     "worst_of_margin": float(theirs[:, 0].max()),
                     "stated_risk": float(a.mean()), "fixed_margin": float(b.mean()),
                     "ratio": float(a.mean() / b.mean()), "low": float(np.quantile(ratio, 0.025)),
                     "high": float(np.quantile(ratio, 0.975))})  # fmt: skip
    return rows
