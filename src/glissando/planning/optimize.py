"""Descent inside a convex body |A c − centre| ≤ width that is never left.

A barrier keeps every iterate strictly inside, its weight falling from step to step; the curvature
of what is minimised is learned from its gradients. Source: Nocedal and Wright, *Numerical
Optimization* (2nd ed.), chapters 6 and 19.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from glissando.geometry.se3 import Array

_BARRIER, _FALL = 1e-2, 0.6  # its first weight as a share of the value, and what is left each step
_NEAREST = 0.9  # of the way to the boundary that a step may go
_SLOPE = 1e-4  # of the promised fall that a step must keep
_HALVINGS = 6
_DAMPED = 0.2  # of the curvature believed so far, the least that a step may tell
_LEAST = 1e-9  # weight of the barrier below which it does not fall

Body = tuple[Array, Array, Array]


def descend(
    value: Callable[[Array], tuple[float, Array]],
    start: Array,
    body: Body,
    iterations: int,
    tolerance: float = 1e-4,
) -> tuple[Array, float]:
    """A point strictly inside the body with a lower value, from a `start` strictly inside.

    `value` gives a number and its gradient. Ends after `iterations`, or when three steps together
    gain less than `tolerance` of the value's size.
    """
    x, (f, g) = start, value(start)
    scale = max(abs(f), 1e-300)
    curvature = np.zeros((x.size, x.size))
    weight, best, recent = _BARRIER * scale / len(body[1]), (x, f), [f]
    for _ in range(iterations):
        pull, stiffness = _barrier(x, body)
        total = g + weight * pull
        step = -cho_solve(cho_factor(curvature + weight * stiffness), total)
        fall = float(total @ step)
        share = min(1.0, _NEAREST * _room(x, step, body))
        here = f + weight * _height(x, body)
        for _ in range(_HALVINGS):
            there = x + share * step
            f_there, g_there = value(there)
            if f_there + weight * _height(there, body) <= here + _SLOPE * share * fall:
                break
            share *= 0.4
        else:
            break
        curvature = _learned(curvature, there - x, g_there - g)
        x, f, g = there, f_there, g_there
        best = min(best, (x, f), key=lambda found: found[1])
        weight = max(_FALL * weight, _LEAST * scale / len(body[1]))
        recent.append(f)
        if len(recent) > 4 and recent[-4] - f < tolerance * scale:
            break
    return best


def strictly_inside(x: Array, centre: Array, body: Body, share: float) -> Array | None:
    """The point x drawn by a `share` of the way to a centre; None if even so it is not inside."""
    drawn = x + share * (centre - x)
    return drawn if np.all(_gap(drawn, body) > 0.0) else None


def _gap(x: Array, body: Body) -> Array:
    rows, centre, width = body
    return (width - np.abs(rows @ x - centre)) / width


def _height(x: Array, body: Body) -> float:
    rows, centre, width = body
    off = (rows @ x - centre) / width
    return -float(np.sum(np.log1p(-(off**2))))


def _barrier(x: Array, body: Body) -> tuple[Array, Array]:
    """Gradient (n,) and curvature (n, n) of the barrier −Σ log(1 − off²)."""
    rows, centre, width = body
    off = (rows @ x - centre) / width
    near, far = 1.0 / (1.0 - off), 1.0 / (1.0 + off)
    scaled = rows * ((near**2 + far**2) / width**2)[:, None]
    return rows.T @ ((near - far) / width), rows.T @ scaled


def _room(x: Array, step: Array, body: Body) -> float:
    """How many such steps lead to the boundary."""
    rows, centre, width = body
    off, move = (rows @ x - centre) / width, rows @ step / width
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.where(move > 0.0, (1.0 - off) / move, (-1.0 - off) / move)
    return float(np.min(ways[move != 0.0], initial=np.inf))


def _learned(curvature: Array, step: Array, change: Array) -> Array:
    """The curvature after a step's change of gradient, kept positive (Powell's damped BFGS)."""
    told, length = float(step @ change), float(step @ step)
    if not np.any(curvature):
        curvature = np.eye(step.size) * max(abs(told) / length, 1e-300)
    along = curvature @ step
    bend = float(step @ along)
    if told < _DAMPED * bend:
        share = (1.0 - _DAMPED) * bend / (bend - told)
        change = share * change + (1.0 - share) * along
        told = float(step @ change)
    return curvature + np.outer(change, change) / told - np.outer(along, along) / bend
