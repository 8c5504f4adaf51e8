"""Interior-point descent inside a convex polytope |A x − centre| ≤ width.

A logarithmic barrier, whose weight decreases from step to step, keeps every iterate strictly
inside. The Hessian of the function is approximated by quasi-Newton updates (damped BFGS). Source:
Nocedal and Wright, *Numerical Optimization* (2nd ed.), chapters 6 and 19.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from glissando.geometry.se3 import Array

_BARRIER, _FALL = 1e-2, 0.6  # initial weight of the barrier over the value; factor per iteration
_LEAST = 1e-9  # smallest weight of the barrier over the value
_NEAREST = 0.9  # longest step, as a share of the way to the boundary
_ARMIJO = 1e-4  # share of the predicted decrease that a step must achieve
_SHRINK, _TRIALS = 0.4, 6  # factor by which a rejected step is shortened, and number of trials
_ROUNDING = 1e-14  # relative rounding error of the curvature
_DAMPED = 0.2  # smallest measured curvature along a step over the approximate one

Polytope = tuple[Array, Array, Array]
"""A (m, n), centre (m,) and half width (m,) of |A x − centre| ≤ width."""
_Sparse = tuple[csr_array, Array, Array]


def descend(
    function: Callable[[Array], tuple[float, Array]],
    start: Array,
    polytope: Polytope,
    iterations: int,
    tolerance: float = 1e-4,
    progress: Callable[[int], None] | None = None,
) -> tuple[Array, float]:
    """Minimise a function from a point strictly inside a polytope.

    Args:
        function: Value and gradient (n,) at a point (n,).
        start: Point (n,) strictly inside.
        polytope: The limits.
        iterations: Largest number of iterations.
        tolerance: Stops when three iterations together gain less than this share of the first
            value.
        progress: Called before each iteration with the number of completed ones.

    Returns:
        The best point (n,), strictly inside, and its value.
    """
    sparse = csr_array(polytope[0]), *polytope[1:]  # at most three non-zeros a row for a path
    x, (value, gradient) = start, function(start)
    scale = max(abs(value), 1e-300)
    curvature = np.zeros((x.size, x.size))
    weight, best, values = _BARRIER * scale / len(sparse[1]), (x, value), [value]
    for done in range(iterations):
        if progress:
            progress(done)
        barrier_gradient, barrier_curvature = _barrier_derivatives(x, sparse)
        total = gradient + weight * barrier_gradient
        try:
            step = -cho_solve(cho_factor(curvature + weight * barrier_curvature), total)
        except np.linalg.LinAlgError:
            break  # at a kink of the function the approximate Hessian is singular to rounding
        decrease = float(total @ step)
        share = min(1.0, _NEAREST * _steps_to_boundary(x, step, sparse))
        merit = value + weight * _barrier(x, sparse)
        for _ in range(_TRIALS):
            new_x = x + share * step
            new_value, new_gradient = function(new_x)
            new_merit = new_value + weight * _barrier(new_x, sparse)
            if new_merit <= merit + _ARMIJO * share * decrease:
                break
            share *= _SHRINK
        else:
            break
        curvature = _updated(curvature, new_x - x, new_gradient - gradient)
        x, value, gradient = new_x, new_value, new_gradient
        best = min(best, (x, value), key=lambda point: point[1])
        weight = max(_FALL * weight, _LEAST * scale / len(sparse[1]))
        values.append(value)
        if len(values) > 4 and values[-4] - value < tolerance * scale:
            break
    return best


def is_inside(x: Array, polytope: Polytope) -> bool:
    """Whether a point (n,) is strictly inside a polytope."""
    rows, centre, width = polytope
    return bool(np.all(np.abs(rows @ x - centre) < width))


def _barrier(x: Array, polytope: _Sparse) -> float:
    """−Σ log(1 − u²) with u = (A x − centre) / width."""
    rows, centre, width = polytope
    return -float(np.sum(np.log1p(-(((rows @ x - centre) / width) ** 2))))


def _barrier_derivatives(x: Array, polytope: _Sparse) -> tuple[Array, Array]:
    """Gradient (n,) and Hessian (n, n) of the barrier."""
    rows, centre, width = polytope
    u = (rows @ x - centre) / width
    near, far = 1.0 / (1.0 - u), 1.0 / (1.0 + u)
    scaled = rows.multiply(((near**2 + far**2) / width**2)[:, None])
    return rows.T @ ((near - far) / width), (rows.T @ scaled).toarray()


def _steps_to_boundary(x: Array, step: Array, polytope: _Sparse) -> float:
    """Multiple of a step that reaches the boundary; infinite if none does."""
    rows, centre, width = polytope
    u, move = (rows @ x - centre) / width, rows @ step / width
    with np.errstate(divide="ignore", invalid="ignore"):
        counts = np.where(move > 0.0, (1.0 - u) / move, (-1.0 - u) / move)
    return float(np.min(counts[move != 0.0], initial=np.inf))


def _updated(curvature: Array, step: Array, change: Array) -> Array:
    """Approximate Hessian, updated by a step's change of gradient (Powell's damped BFGS)."""
    measured = float(step @ change)
    if not np.any(curvature):
        curvature = np.eye(step.size) * max(abs(measured) / float(step @ step), 1e-300)
    along = curvature @ step
    predicted = float(step @ along)
    if predicted <= _ROUNDING * float(np.trace(curvature)) * float(step @ step):
        return curvature  # the approximation is flat along this step
    if measured < _DAMPED * predicted:
        share = (1.0 - _DAMPED) * predicted / (predicted - measured)
        change = share * change + (1.0 - share) * along
        measured = float(step @ change)
    return curvature + np.outer(change, change) / measured - np.outer(along, along) / predicted
