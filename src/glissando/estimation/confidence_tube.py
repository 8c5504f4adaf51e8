"""Surface around a robot that contains it with a stated confidence."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.quantiles import chi_square_quantile

SIGMAS_95 = float(np.sqrt(chi_square_quantile(0.95, 3)))
"""Standard deviations of the ellipsoid that holds 95 % of a Gaussian in three dimensions."""

_CAP = 5  # rings that round off each end


def confidence_tube(
    pose: Array, cov: Array, sigmas: float = SIGMAS_95, *, around: int = 24
) -> tuple[Array, Index]:
    """Rings of the confidence surface of poses along a robot, and the points they belong to.

    A ring is the ellipse of the lateral 2×2 block of the covariance, parametrised by its symmetric
    root, which is smooth where principal axes would flip; both ends are rounded off.

    Args:
        pose: Poses (…, N, 4, 4), body to world, m.
        cov: Covariances (…, N, 3, 3) of the positions in the body frame, m².
        sigmas: Size of the surface in standard deviations.
        around: Points of a ring.

    Returns:
        Rings (…, R, around, 3) in the world frame, m, and the point (R,) of each.
    """
    count = pose.shape[-3]
    ring, across, height = _unit_tube(count, around)
    flat = cov[..., :2, :2]
    det = flat[..., 0, 0] * flat[..., 1, 1] - flat[..., 0, 1] * flat[..., 1, 0]
    product = np.sqrt(np.maximum(det, 0.0))
    total = np.sqrt(np.einsum("...ii->...", flat) + 2.0 * product + 1e-24)
    root = (flat + product[..., None, None] * np.eye(2)) / total[..., None, None]
    along = height * np.sqrt(np.maximum(cov[..., ring, 2, 2], 0.0))
    body = np.empty((*along.shape, around, 3))
    body[..., :2] = across @ root[..., ring, :, :]
    body[..., 2] = along[..., None]
    pose = pose[..., ring, :, :]
    turned = body @ np.swapaxes(pose[..., :3, :3], -1, -2)
    return pose[..., None, :3, 3] + sigmas * turned, ring


@lru_cache(maxsize=16)
def _unit_tube(count: int, around: int) -> tuple[Index, Array, Array]:
    """Indices (R,) of the rings' points, and rings of a unit tube: (R, around, 2), heights (R,)."""
    rest = np.linspace(0.0, 0.5 * np.pi, _CAP, endpoint=False)
    tilt = np.concatenate([rest - 0.5 * np.pi, np.zeros(count), 0.5 * np.pi - rest[::-1]])
    ring = np.concatenate([[0] * _CAP, np.arange(count), [count - 1] * _CAP])
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    across = np.cos(tilt)[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return _fixed(ring), _fixed(across), _fixed(np.sin(tilt))


@lru_cache(maxsize=16)
def tube_faces(rings: int, around: int) -> NDArray[np.intp]:
    """Triangles (F, 3) between the points of rings, numbered ring by ring.

    Args:
        rings: Number of rings.
        around: Points of a ring.
    """
    here = np.arange(rings * around).reshape(rings, around)
    on = np.roll(here, -1, axis=1)
    a, b, c, d = here[:-1], on[:-1], here[1:], on[1:]
    return _fixed(np.stack([a, b, c, b, d, c], axis=-1).reshape(-1, 3))


def _fixed(array: NDArray[Any]) -> NDArray[Any]:
    """The array, made read-only, as all callers share it."""
    array.flags.writeable = False
    return array
