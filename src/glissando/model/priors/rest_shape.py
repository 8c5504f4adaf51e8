"""The shape a robot has at rest: strain that varies linearly inside each segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import segment_at

STRAIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class RestShape:
    """Rest strain along a body of S segments that meet at `joints` (S−1,) in metres.

    `strain` (S, 6) is the strain where each segment begins, `slope` (S, 6) its change per metre.
    """

    strain: Array
    slope: Array
    joints: Array

    @classmethod
    def of_segments(cls, strain: Array, slope: Array, joints: Array) -> RestShape:
        """Shape from strain and slope, (6,) of the whole body or (S, 6) of its segments."""
        strain, slope = np.broadcast_arrays(np.atleast_2d(strain), np.atleast_2d(slope))
        return cls(strain, slope, joints if len(strain) > 1 else np.zeros(0))

    def at(self, arclength: Array) -> Array:
        """Rest strain (M, 6) at arclengths (M,); at a joint that of the segment beyond."""
        segment = segment_at(self.joints, arclength)
        begins = np.concatenate([[0.0], self.joints])[segment]
        return self.strain[segment] + (arclength - begins)[:, None] * self.slope[segment]

    def error(self, arclength: Array, offset: Array) -> Array:
        """Error (M, 12) at rest of pieces that begin at `arclength` (M,), `offset` (M,) long.

        [log(exp(−u ε₀) T₀⁻¹ T(u)); ε(u) − ε₀] without a joint inside, the product of
        exponentials by Magnus' expansion to the order u⁵. Source: equation (2').
        """
        if not self.slope.any():  # zero for a constant strain
            return np.zeros((arclength.size, 12))
        strain = self.at(arclength)
        slope = self.slope[segment_at(self.joints, arclength)]
        u = offset[:, None]
        turned = np.einsum("mij,mj->mi", se3.ad(strain), slope)
        ahead = u * strain + 0.5 * u**2 * slope + u**3 / 12.0 * turned
        pose = se3.log(se3.exp(-u * strain) @ se3.exp(ahead))
        return np.concatenate([pose, u * slope], axis=1)

    def interval_errors(self, arclength: Array) -> Array:
        """Errors (N−1, 12) at rest of the intervals between nodes (N,), their jumps included."""
        error = self.error(arclength[:-1], np.diff(arclength))
        error[:, 6:] = np.diff(self.at(arclength), axis=0)
        return error

    def poses(self, base: Array, arclength: Array) -> Array:
        """Poses (N, 4, 4) at nodes (N,) at rest, the first of which is at the `base` (4, 4)."""
        lengths = np.diff(arclength)
        miss = se3.exp(self.error(arclength[:-1], lengths)[:, :6])
        steps = se3.exp(lengths[:, None] * self.at(arclength[:-1])) @ miss
        out = [base]
        for step in steps:
            out.append(out[-1] @ step)
        return np.array(out)
