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
        parts, moments = _parts(problem, motion), problem.space.moments
        split = np.flatnonzero(parts > 1)
        if not split.size:
            break
        times = [np.linspace(moments[k], moments[k + 1], int(parts[k]) + 1)[1:-1] for k in split]
        space = problem.space.with_moments(np.concatenate(times))
        search = replace(search, problem=replace(problem, space=space), last=None)
        motion = search.at(motion.control)
    return search, motion


def _parts(problem: MotionProblem, motion: Evaluation) -> Index:
    """How many parts (K−1,) the time to the next moment needs, each twice as many as another."""
    space, clearances = problem.space, motion.clearances
    way = np.linalg.norm(np.diff(motion.shapes.place, axis=0), axis=-1)
    least = _both(clearances.mean, np.minimum) - way
    near = np.any(least < _NEAR * _both(clearances.std(), np.maximum), axis=0)
    longest = np.max(way, axis=1, where=near, initial=0.0)
    strides = longest / (_STRIDE * problem.scene.robot_radius)
    most = np.diff(space.moments) * 2**_HALVINGS / space.correction
    halvings = np.ceil(np.log2(np.clip(strides, 1.0, None)))
    out: Index = (2.0 ** np.minimum(halvings, np.round(np.log2(most)))).astype(np.intp)
    return out


def _both(values: Array, which: np.ufunc) -> Array:
    """Of values (O, K, N), those (O, K−1, N) of a moment or the next."""
    out: Array = which(values[:, 1:], values[:, :-1])
    return out
