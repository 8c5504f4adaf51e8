"""Moments so close that nothing passes unseen between two, where the body comes near something.

A motion is judged when commands are corrected, and in between where a place that comes near an
obstacle would otherwise go too far from one moment to the next.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.motion_search import Search

_STRIDE = 1.0  # robot radii that a place near something may go between two moments
_NEAR = 5.0  # standard deviations of clearance beyond which nothing is hit
_HALVINGS = 4  # of the time between two corrections at most


def judged_closely(search: Search, motion: Evaluation) -> tuple[Search, Evaluation]:
    """The search with all moments that a motion needs, and the motion judged at these."""
    for _ in range(_HALVINGS):
        problem = search.problem
        between = _too_far_apart(problem, motion)
        if not between.size:
            break
        moments = problem.space.moments
        space = problem.space.with_moments(0.5 * (moments[between] + moments[between + 1]))
        search = replace(search, problem=replace(problem, space=space), last=None)
        motion = search.at(motion.control)
    return search, motion


def _too_far_apart(problem: MotionProblem, motion: Evaluation) -> Index:
    """Numbers of the moments to the next of which a place goes too far near something."""
    space, clearances = problem.space, motion.clearances
    apart = np.diff(space.moments) > 1.5 * space.correction / 2**_HALVINGS
    way = np.linalg.norm(np.diff(motion.shapes.place, axis=0), axis=-1)
    far = way > _STRIDE * problem.scene.robot_radius
    least = _both(clearances.mean, np.minimum) - way
    near: Array = least < _NEAR * _both(clearances.std(), np.maximum)
    return np.flatnonzero(apart & np.any(far & near, axis=(0, 2)))


def _both(values: Array, which: np.ufunc) -> Array:
    """Of values (O, K, N), those (O, K−1, N) of a moment or the next."""
    out: Array = which(values[:, 1:], values[:, :-1])
    return out
