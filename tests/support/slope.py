"""The slope test: a Jacobian is right when its prediction errs as the square of the step."""

import numpy as np

from glissando.model.interpolation import sort_points
from glissando.model.state import DOF

_LARGEST, _DECADES = 1e-2, 3
_SLACK = 4.0  # room for third-order terms
_ROUNDING = 1e-12  # of the values at hand: below it there is nothing left to measure


def slope_test(f, jacobian, *, difference=np.subtract, seed=0, directions=3):
    """Assert that |f(x ⊕ h d) ⊖ [f(x) + h J d]| falls as h² over three decades.

    `f` maps a step (..., d) away from x to values, `jacobian` is (..., r, d) and `difference`
    (f(x ⊕ step), f(x)) to (..., r). Steps are drawn for all leading dimensions at once, every
    element must pass on its own, and a map that is linear passes by having no error at all.
    """
    rng = np.random.default_rng(seed)
    shape = (*jacobian.shape[:-2], jacobian.shape[-1])
    here = f(np.zeros(shape))
    for _ in range(directions):
        way = rng.standard_normal(shape)
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        slope = np.einsum("...ij,...j->...i", jacobian, way)
        floor = _ROUNDING * (1.0 + np.abs(slope).max() + _size(here))
        steps = _LARGEST * 10.0 ** -np.arange(_DECADES + 1)
        errors = [_norm(difference(f(h * way), here) - h * slope) for h in steps]
        for h, error in zip(steps[1:], errors[1:], strict=True):
            allowed = _SLACK * errors[0] * (h / steps[0]) ** 2 + floor
            worst = np.unravel_index(np.argmax(error - allowed), np.shape(error))
            assert np.all(error <= allowed), (
                f"element {tuple(map(int, worst))}: with a step of {h:.0e} the prediction is off "
                f"by {error[worst]:.2e}; second order allows {allowed[worst]:.2e}"
            )


PLACES = ["node", "between arclengths", "between times", "cell"]
"""Where states are asked for by `interpolation_slope_test`."""


def interpolation_slope_test(prior, grid, state, place, scale=1.0):
    """Assert that a prior's states between nodes have the Jacobian, and the nodes, that they say.

    The place is one of `PLACES`; steps of the nodes are multiplied by `scale` (K, N, dof).
    """
    s = [0.05, 0.13, 0.39] if place in PLACES[1::2] else grid.arclength[[0, 1, -1]]
    t = grid.time[-1] * np.array([0.28, 0.44, 0.8]) if place in PLACES[2:] else grid.time
    (points,) = sort_points(grid, np.array(s), t)
    found = prior.interpolate(grid, state, state, points)
    scale = np.broadcast_to(scale, (*grid.shape, state.dof))

    def moved(step):
        there = state.retract(scale * step.reshape(scale.shape))
        return prior.interpolate(grid, there, state, points).state

    jacobian = np.zeros((3, DOF, scale[..., 0].size, state.dof))
    for row, nodes in enumerate(found.nodes):
        jacobian[row][:, nodes] = found.jacobian[row]
    jacobian = jacobian.reshape(3 * DOF, -1) * scale.ravel()
    slope_test(moved, jacobian, difference=lambda there, here: there.difference(here).ravel())


def _norm(vectors):
    return np.linalg.norm(np.atleast_2d(vectors), axis=-1)


def _size(values):
    return np.abs(values).max() if isinstance(values, np.ndarray) else 1.0
