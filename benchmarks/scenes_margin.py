"""Risk allocation against a fixed margin of clearance, for `scenes.py`.

A planner that keeps the expected body a fixed margin away from all obstacles plans the same scenes,
with several margins, and with the margin at which each scene's risk equals the plan's. The slides
move as in the motion with a stated risk, and the same robots follow all motions.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np

from glissando.errors import GlissandoError
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.sampled_risk import sample_risk
from scenes_world import followed

SHARP = 1e-4  # m: standard deviation that smooths a margin
MARGINS = "2", "2.5", "3", "3.25", "3.5", "4", "equal"  # mm, and of equal risk in each scene
WIDEST, HALVINGS = 6e-3, 6  # m: upper limit, and bisections, of the margin of equal risk


def with_margin(robot, plan, margin):
    """Plan with a motion that keeps a margin (m), and its risk; None if there is no such motion.

    The search has the same initial guesses as the plan's, and the plan itself.
    """
    scene = plan.problem.scene
    surely = replace(robot, tendons=replace(robot.tendons, std=1e-7, psd_moment=1e-14))
    wide = replace(
        scene, robot_radius=scene.robot_radius + margin, model_std=SHARP, delta=0.5, sensors=[],
        slides=[],
    )  # fmt: skip
    own = plan.evaluation.control
    try:
        problem = motion_problem(wide, surely)
        warm = own[: len(scene.tendons)]
        keeping = plan_motion(problem, candidates=3, iterations=40, warm_start=warm)
    except GlissandoError:
        return None
    control = np.concatenate([keeping.evaluation.control, own[len(scene.tendons) :]])
    at = plan.problem.evaluate(control)
    return replace(plan, evaluation=at, risk=sample_risk(plan.problem, at)[0])


def with_equal_risk(robot, plan):
    """Plan with the least margin, by bisection, whose risk is not larger than the given plan's."""
    low, high, found = 0.0, WIDEST, None
    for _ in range(HALVINGS):
        margin = 0.5 * (low + high)
        keeping = with_margin(robot, plan, margin)
        if keeping is None or keeping.risk <= plan.risk:
            high, found = margin, keeping or found
        else:
            low = margin
    return found


def judged(plan):
    """Risk, time until the tip stays at its target (s), length of its path (m), and cost."""
    even = plan.evenly()
    at, moments = even.evaluation, even.problem.space.moments
    target = plan.problem.scene.targets[-1]
    far = np.linalg.norm(at.tip - target.position, axis=1) > 1.05 * target.tolerance
    last = np.flatnonzero(far).max(initial=-1) + 1
    way = np.linalg.norm(np.diff(at.tip, axis=0), axis=1).sum()
    return np.array([plan.risk, moments[min(last, far.size - 1)], way, at.cost])


def margin_rows(pool, robot, seeded, options):
    """Rows for motions with a stated risk, and for each margin: risks, hits, and ratios.

    Ratios are of sums over the scenes in which a margin is feasible, stated risk over margin, with
    95 % bootstrap intervals over scenes.
    """
    seeds, plans = [seed for seed, _ in seeded], [plan for _, plan in seeded]
    rows, rng = [described("stated", plans, plans, rng=None)], np.random.default_rng(0)
    rows[0] |= followed_by_all(pool, robot, seeds, plans, options.runs)
    for margin in options.margin or MARGINS:
        equal = margin == "equal"
        kept = {} if equal else {"margin": 1e-3 * float(margin)}
        keeping = partial(with_equal_risk if equal else with_margin, robot, **kept)
        theirs = pool.map(keeping, plans, 1)
        row = described("equal risk" if equal else f"{margin} mm", plans, theirs, rng)
        rows.append(row | followed_by_all(pool, robot, seeds, theirs, options.runs))
        print(f"  {rows[-1]}", file=sys.stderr, flush=True)
    return rows


def described(name, ours, theirs, rng):
    """Row of a margin: risks of its motions, and ratios of ours to these."""
    both = [(judged(a), judged(b)) for a, b in zip(ours, theirs, strict=True) if b is not None]
    row = {"margin": name, "scenes": len(ours), "passed": len(both)}
    if not both:
        return row
    ours, theirs = np.moveaxis(np.array(both), 1, 0)
    row |= {"risk": float(theirs[:, 0].mean()), "worst": float(theirs[:, 0].max())}
    for k, what in enumerate(("time", "way", "cost"), start=1):
        a, b = ours[:, k], theirs[:, k]
        row[what] = float(a.sum() / b.sum())
        if rng:
            drawn = rng.integers(0, a.size, (2000, a.size))
            ratio = a[drawn].sum(axis=1) / b[drawn].sum(axis=1)
            row[what] = [row[what], *np.quantile(ratio, [0.025, 0.975]).tolist()]
        else:
            row[what] = float(a.mean())
    return row


def followed_by_all(pool, robot, seeds, plans, runs):
    """Number of robots that follow the motions, `runs` per feasible scene, and of hits."""
    tasks = [(robot, plan, seed, runs) for seed, plan in zip(seeds, plans, strict=True) if plan]
    return {"runs": runs * len(tasks), "hits": sum(pool.imap_unordered(hits_of, tasks))}


def hits_of(task):
    """Number of a scene's robots that hit an obstacle, for a task (robot, plan, seed, robots)."""
    robot, plan, seed, runs = task
    return sum(followed(plan, robot, 10_000 * seed + n)[0] < 0.0 for n in range(runs))
