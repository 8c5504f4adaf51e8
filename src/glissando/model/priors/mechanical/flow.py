"""Flow of a rod from one cross-section to another: path, transition matrix and process noise.

The state of a cross-section is its pose and internal wrench W = [n; m] (body frame). The path is a
Lie series of fourth order: strain and its first three derivatives follow from (26), Magnus'
expansion gives the pose, and that pose transforms the wrench exactly. Jacobians are those of this
series. Arrays are batches over intervals with a leading axis M. Source: equations (26) and (27).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando._kernels import rod_flow as kernels
from glissando._kernels.arrays import items
from glissando.geometry.se3 import Array


@dataclass(frozen=True)
class Section:
    """Stiffness, rest strain, weight and noise densities of intervals (M,).

    Attributes:
        stiffness: Stiffness (M, 6), N and N m².
        rest: Strain (M, 6) without wrench where intervals begin.
        rest_slope: Change of the rest strain per metre (M, 6).
        weight: Weight per metre (M, 3) in the world frame, N/m.
        psd: Densities (M, 12) of the noise on strain and on the wrench.
        weight_slope: Change of the weight per metre (M, 3), N/m².
    """

    stiffness: Array
    rest: Array
    rest_slope: Array
    weight: Array
    psd: Array
    weight_slope: Array

    def take(self, index: np.ndarray) -> Section:
        """Section of the intervals with the given indices."""
        return Section(*(field[index] for field in vars(self).values()))

    def ahead(self, offset: Array) -> Section:
        """Section of the intervals without their first `offset` (M,) metres."""
        along = offset[:, None]
        rest, weight = self.rest + along * self.rest_slope, self.weight + along * self.weight_slope
        return replace(self, rest=rest, weight=weight)


@dataclass(frozen=True)
class Flow:
    """End of an undisturbed rod, with its Jacobians and process noise.

    Attributes:
        pose: Pose (M, 4, 4) of the end in the frame of the beginning.
        wrench: Internal wrench (M, 6) at the end.
        transition: Jacobian Φ (M, 12, 12) of [pose, wrench] at the end by those at the beginning.
        noise: Covariance Q (M, 12, 12) of [pose, wrench] at the end.
        by_weight: Jacobian (M, 12, 6) of the end by the weight where the interval begins and by
            its change per metre.
    """

    pose: Array
    wrench: Array
    transition: Array
    noise: Array
    by_weight: Array


def flow(rotation: Array, wrench: Array, step: Array, section: Section, *, noisy: bool) -> Flow:
    """Flow of undisturbed rods from the beginnings of intervals to their ends. Source: (27).

    Args:
        rotation: Rotation (M, 3, 3) at the beginning, body to world.
        wrench: Internal wrench (M, 6) at the beginning, body frame.
        step: Lengths (M,), m.
        section: Section of the intervals.
        noisy: Whether to compute the covariance, which else is zero.
    """
    m = len(step)
    made = section.stiffness, section.rest, section.rest_slope
    acting = section.weight, section.weight_slope, section.psd
    widths = 6, 6, 6, 3, 3, 12
    fields = [items(x, (m,), w) for x, w in zip((*made, *acting), widths, strict=True)]
    begin = items(rotation, (m,), 3, 3), items(wrench, (m,), 6), items(step, (m,))
    return Flow(*kernels.flow(*begin, *fields, noisy))
