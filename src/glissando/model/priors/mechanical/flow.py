"""A rod from one cross-section to another: its path, how errors travel along it, and their noise.

A cross-section is its pose and internal wrench W = [n; m] (body frame). The path is a Lie series
of fourth order: strain and its first three derivatives follow from (26), Magnus' expansion turns
them into a pose, and the wrench is carried by that pose exactly. Slopes are those of this very
path. Everything is a batch over intervals with a leading axis M. Source: equations (26) and (27).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando._kernels import rod_flow as kernels
from glissando._kernels.arrays import items
from glissando.geometry.se3 import Array


@dataclass(frozen=True)
class Section:
    """What intervals (M,) are made of and what is known to act on them.

    Attributes:
        stiffness: (M, 6), N and N m².
        rest: Strain (M, 6) that carries no wrench, where intervals begin.
        rest_slope: Its change per metre (M, 6).
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
        """Those of the intervals."""
        return Section(*(field[index] for field in vars(self).values()))

    def ahead(self, offset: Array) -> Section:
        """The intervals without their first `offset` (M,) metres."""
        along = offset[:, None]
        rest, weight = self.rest + along * self.rest_slope, self.weight + along * self.weight_slope
        return replace(self, rest=rest, weight=weight)


@dataclass(frozen=True)
class Flow:
    """Where an undisturbed rod arrives.

    Attributes:
        pose: The end (M, 4, 4) in the frame of the beginning.
        wrench: Internal wrench (M, 6) at the end.
        transition: Its slope Φ (M, 12, 12): [pose, wrench] of the end by those of the beginning.
        noise: Covariance Q (M, 12, 12) of [pose, wrench] at the end.
        by_weight: Slope (M, 12, 6) of the end by the weight where the interval begins and by the
            weight's slope.
    """

    pose: Array
    wrench: Array
    transition: Array
    noise: Array
    by_weight: Array


def flow(rotation: Array, wrench: Array, step: Array, section: Section, *, noisy: bool) -> Flow:
    """The rod from where intervals begin to their ends. Source: equation (27).

    Args:
        rotation: Of the beginning (M, 3, 3), body to world.
        wrench: Internal wrench (M, 6) at the beginning, body frame.
        step: Lengths (M,), m.
        section: What the intervals are made of.
        noisy: Whether the covariance is asked for; zero else.
    """
    m = len(step)
    made = section.stiffness, section.rest, section.rest_slope
    acting = section.weight, section.weight_slope, section.psd
    widths = 6, 6, 6, 3, 3, 12
    fields = [items(x, (m,), w) for x, w in zip((*made, *acting), widths, strict=True)]
    begin = items(rotation, (m,), 3, 3), items(wrench, (m,), 6), items(step, (m,))
    return Flow(*kernels.flow(*begin, *fields, noisy))
