"""Start motions of a search: feasibility of start and targets, and paths to the targets."""

from __future__ import annotations

from itertools import product

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.sampled_risk import at_close_places, sample_risk

_BENDS = 120  # number of start motions by way of random bends, in a scene with obstacles
_BEND = 0.4  # rad, standard deviation of the random bend of a segment
# share of the way to the first target at which a bend is added; over the target's time, the time
# of the bend and the time from it to the target
_SHARE, _WHEN, _LASTS = (0.2, 0.8), (0.25, 0.6), 0.35


def require_possible_start(problem: MotionProblem) -> None:
    """Raise unless the robot is clear of all obstacles at its start.

    Raises:
        GlissandoError: The robot starts in collision, or its probability exceeds the allowed risk.
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
    """Raise unless the tip can be within tolerance of each target without touching an obstacle.

    Raises:
        GlissandoError: A target lies in an obstacle, or too close to one for the robot's radius.
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
    """Displacements (T,), m, with which the tip reaches a target, by damped Gauss–Newton steps.

    Raises:
        GlissandoError: The target is out of reach within the tendons' limits.
    """
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
    """Control points (C, S+2) of the motions with which a search begins.

    The tendons go directly to displacements `reaches` (G, T) of the targets, at two speeds, or by
    way of random displacements; each is combined with slides that hold, go to the middle, or
    oscillate. In scenes with obstacles, tendons also go by way of random bends, with slides as in
    the first combination. Tendons and slides of a `warm` motion (C, S+2) are added to both lists as
    their first entries.
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
    """Tendon targets (T, S+2) of motions by way of random bends; none without obstacles.

    The side on which a motion passes an obstacle decides most of its cost, and a search seldom
    changes sides. Random bends of all segments reach more sides than random displacements, most of
    which only strain tendons against each other.
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
    """A motion (C, S+2), and copies whose slides pass through three places on a grid of four."""
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
