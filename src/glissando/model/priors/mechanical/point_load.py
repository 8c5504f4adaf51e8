"""Unknown wrenches that act at a point, from the errors of the intervals that end there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.priors.mechanical.intervals import Intervals, still_columns, still_error
from glissando.model.state import State


@dataclass(frozen=True)
class PointLoad:
    """Wrenches (M, 6) in the body frame, conditional on the states of nodes.

    Attributes:
        mean: Mean (M, 6), N and N m.
        nodes: Indices k·N + n (M, 2) of the nodes on which they depend.
        jacobian: Jacobians (M, 6, 2, 12) by pose and strain of the nodes, or (M, 6, 2, 15) with
            the acceleration.
        cov: Covariance (M, 6, 6) when the nodes are known.
    """

    mean: Array
    nodes: Index
    jacobian: Array
    cov: Array


def point_load(
    start: State,
    end: State,
    piece: Intervals,
    nodes: Index,
    tip: tuple[NDArray[np.bool_], Array, Array],
) -> PointLoad:
    """The unknown wrench that acts where intervals end. Source: equation (28).

    It is the jump at an interval's end conditional on the interval's error, and at the tip also the
    wrench beyond the weight of the tool.

    Args:
        start: Nodes (M,) where the intervals begin.
        end: Nodes (M,) where they end.
        piece: The intervals.
        nodes: Indices (M, 2) of both nodes.
        tip: Mask (M,) of the ends at the tip, and `tip_error` of all ends.
    """
    last, at_tip, slope = tip
    count = len(last)
    mean, cov, cross = np.zeros((count, 6)), np.zeros((count, 6, 6)), np.zeros((count, 6, 12))
    error, slopes = still_error(start, end, piece)
    noise = piece.flow(start, noisy=True).noise
    cross[:, range(6), range(6, 12)] = -piece.jump / piece.end_stiffness
    gain = np.swapaxes(np.linalg.solve(noise, np.swapaxes(cross, -1, -2)), -1, -2)
    mean += np.einsum("mij,mj->mi", gain, error)
    jacobian = np.einsum("mij,mjcd->micd", gain, slopes)
    cov += piece.jump[:, :, None] * np.eye(6) - gain @ np.swapaxes(cross, -1, -2)
    mean[last] += at_tip[last, :6]
    jacobian[last, :, 1] += slope[last, :6][..., still_columns(jacobian.shape[-1])]
    return PointLoad(mean, nodes, jacobian, cov)
