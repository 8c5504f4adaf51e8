"""Where a search for a motion begins: what is possible at all, and ways to the targets."""

from __future__ import annotations

from itertools import product

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.sampled_risk import at_close_places, sample_risk

_BENDS = 120  # random bends by way of which a motion may begin, where something is in the way
_BEND = 0.4  # rad, standard deviation of the bend of a tendon robot's segment on the way
_SHARE, _WHEN, _LASTS = (0.2, 0.8), (0.25, 0.6), 0.35  # of the way, and of the time to the target


def require_possible_start(problem: MotionProblem) -> None:
    """Raise unless the robot is clear of everything where it starts.

    Raises:
        GlissandoError: It is in collision, or more likely to be than is allowed.
    """
    space, scene = problem.space, problem.scene
    still = np.stack([np.full(path.steps + 2, path.start) for path in space.paths])
    at = problem.evaluate(still)
    if not scene.obstacles:
        return
    finer, _, clearances = at_close_places(problem, at)
    clearance = clearances.mean[:, 0] + finer.radius - scene.robot_radius
    o, n = np.unravel_index(int(np.argmin(clearance)), clearance.shape)
    if clearance[o, n] < 0.0:
        deep = -float(clearance[o, n])
        advice = "move the obstacle, or start elsewhere"
        if deep > finer.body.arclength[-1]:
            advice = "give its size and place in metres"
        raise GlissandoError(
            f"The robot starts in collision: at arclength {finer.body.arclength[n]:.3g} m it is "
            f"{1e3 * deep:.3g} mm inside obstacle {o + 1}; {advice}."
        )
    risk, std = sample_risk(problem, at, moments=1)
    if risk > scene.delta + 2.0 * std:
        raise GlissandoError(
            f"Where it starts, the robot already touches something with a probability of "
            f"{100 * risk:.3g} %, nearest to obstacle {o + 1}; {100 * scene.delta:.3g} % are "
            f"allowed. Know the robot better, start elsewhere, or allow more."
        )


def require_clear_targets(problem: MotionProblem) -> None:
    """Raise unless the tip may be at each target, in its tolerance, without touching anything.

    Raises:
        GlissandoError: A target lies in an obstacle, or too near to it for the robot.
    """
    scene = problem.scene
    for target in scene.targets:
        for o, obstacle in enumerate(scene.obstacles):
            away = float(obstacle.distance(target.position[None])[0][0])
            short = scene.robot_radius - away - target.tolerance
            if short > 0.0:
                raise GlissandoError(
                    f"Target {target.position.tolist()} m is {1e3 * away:.3g} mm from obstacle "
                    f"{o + 1}: within its tolerance the robot, whose radius is "
                    f"{1e3 * scene.robot_radius:.3g} mm, is {1e3 * short:.3g} mm inside; move one "
                    f"of them."
                )


def reach_target(problem: MotionProblem, number: int) -> Array:
    """Displacements (T,) with which the tip comes to a target, by damped Gauss–Newton."""
    scene, body, target = problem.scene, problem.body, problem.scene.targets[number]
    paths = problem.space.paths[: len(scene.tendons)]
    lower, upper = (np.array([getattr(a, end) for a in paths]) for end in ("lower", "upper"))
    error = problem.expected(target.time)
    rng = np.random.default_rng(number)
    best: tuple[float, Array] = (np.inf, lower)
    for attempt in range(4):
        at = np.array([a.start for a in scene.tendons])
        if attempt:
            at = lower + rng.uniform(0.1, 0.6, lower.size) * (upper - lower)
        at, damping, miss = np.clip(at, lower, upper), 1e-3, np.inf
        for _ in range(60):
            shape = body.shapes(at[None], error[None])
            away = shape.place[0, -1] - target.position
            if float(np.linalg.norm(away)) < best[0]:
                best = float(np.linalg.norm(away)), at
            jacobian = shape.tip_by_displacement()[0]
            damping = damping * (0.5 if np.linalg.norm(away) < miss else 4.0)
            miss = float(np.linalg.norm(away))
            weight = damping * float(np.trace(jacobian @ jacobian.T))
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + weight * np.eye(3), away)
            new = np.clip(at - step, lower, upper)
            if miss < 0.1 * target.tolerance or np.abs(new - at).max() < 1e-9:
                break
            at = new
        if best[0] < target.tolerance:
            break
    if best[0] > target.tolerance:
        raise GlissandoError(
            f"Target {target.position.tolist()} m is out of reach: within the limits of its "
            f"tendons the tip comes no nearer than {1e3 * best[0]:.3g} mm, and "
            f"{1e3 * target.tolerance:.3g} mm are asked for; move the target, or allow more."
        )
    return best[1]


def starts(
    problem: MotionProblem, reaches: Array, seed: int, warm: Array | None = None
) -> list[Array]:
    """Motions (C, S+2) that a search begins with.

    Straight to displacements (G, T) that reach the targets, at once and slowly, and by way of
    random displacements; the slides hold, go in, or oscillate. Where something is in the way, they
    also go by way of random bends, with the first of the slides. Tendons and slides of a `warm`
    motion (C, S+2) come first, with each other and with all of these.
    """
    scene, space = problem.scene, problem.space
    rng, path = np.random.default_rng(seed), space.paths[0]
    time, count = path.control_times, len(scene.tendons)
    at = np.array([p.start for p in space.paths])
    ends = np.array([target.time for target in scene.targets])
    knots = np.concatenate([[0.0], ends])
    upper = np.array([p.upper for p in space.paths[:count]])
    lower = np.array([p.lower for p in space.paths[:count]])
    ways = []
    for early in (1.0, 0.6):
        via = np.stack([np.interp(time, early * knots, column) for column in
                        np.concatenate([at[None, :count], reaches]).T])  # fmt: skip
        ways.append(via)
    for _ in range(4):
        middle = lower + rng.uniform(0.0, 0.6, count) * (upper - lower)
        places = np.concatenate([at[None, :count], middle[None], reaches])
        when = np.concatenate([[0.0, 0.45 * ends[0]], ends])
        ways.append(np.stack([np.interp(time, when, column) for column in places.T]))
    slides = [np.repeat(at[count:, None], time.size, axis=1)]
    if scene.slides and problem.senses:
        low, high = (np.array([[getattr(s, e)] for s in scene.slides]) for e in ("lower", "upper"))
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * time / max(time[-1] / 3.0, 1e-9))
        slides += [np.repeat(0.5 * (low + high), time.size, axis=1), high + (low - high) * wave]
    if warm is not None:
        ways.insert(0, warm[:count])
        slides.insert(0, warm[count:])
    pairs = [
        *product(ways, slides),
        *((way, slides[0]) for way in _by_bends(problem, reaches, rng)),
    ]
    return [space.follow(np.concatenate(pair)) for pair in pairs]


def _by_bends(problem: MotionProblem, reaches: Array, rng: np.random.Generator) -> list[Array]:
    """Tendons (T, S+2) on ways to the targets past random bends, if something is in the way.

    On which side of an obstacle a motion passes decides most of its cost, and a search seldom
    leaves the side where it began. Bends of all segments reach more sides than displacements,
    most of which only strain tendons against each other.
    """
    scene, tendons = problem.scene, problem.body.rod.tendons
    time, first = problem.space.paths[0].control_times, scene.targets[0].time
    start = np.array([path.start for path in problem.space.paths])[: len(scene.tendons)]
    ends, segment = np.unique(tendons.end, return_inverse=True)
    across = np.stack([np.cos(tendons.angle), np.sin(tendons.angle)], axis=1)
    when = np.array([target.time for target in scene.targets])
    ways = []
    for _ in range(_BENDS if scene.obstacles else 0):
        bend = np.cumsum(_BEND * rng.standard_normal((ends.size, 2)), axis=0)
        pulled = tendons.radius * np.sum(bend[segment] * across, axis=1)
        middle = start + rng.uniform(*_SHARE) * (reaches[0] - start) + pulled
        begin = rng.uniform(*_WHEN)
        knots = np.concatenate([[0.0, begin * first, (begin + _LASTS) * first], when])
        places = np.concatenate([start[None], middle[None], reaches[:1], reaches])
        ways.append(np.stack([np.interp(time, knots, column) for column in places.T]))
    return ways


def slide_ways(problem: MotionProblem, control: Array) -> list[Array]:
    """A motion (C, S+2), and the same with slides that go by way of three places each."""
    scene, space = problem.scene, problem.space
    if not (scene.slides and problem.senses):
        return [control]
    count, time = len(scene.tendons), space.paths[0].control_times
    share = np.linspace(0.0, time[-1], 4)
    ways = [control]
    for via in product(np.linspace(0.0, 1.0, 4), repeat=3):
        new = control.copy()
        for c, path in enumerate(space.paths[count:], start=count):
            places = path.lower + np.array(via) * (path.upper - path.lower)
            new[c] = np.interp(time, share, [path.start, *places])
        ways.append(space.follow(new))
    return ways
