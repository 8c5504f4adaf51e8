"""The whole-body tube of a robot file: its width and its guaranteed coverage."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tube:
    """A tube around the body that contains all evaluated places of a block simultaneously.

    A place is inside if its error lies in the ellipsoid of `sigmas` standard deviations of the
    estimate there. The guarantee needs no model of errors: a further block, exchangeable with the
    `blocks` that determined the width, lies wholly inside with a probability of at least `level`.
    It holds for whole blocks, not for single samples. Source: Vovk, Gammerman and
    Shafer, *Algorithmic Learning in a Random World* (2005), split conformal prediction.

    Attributes:
        level: Guaranteed probability.
        sigmas: Half-width in standard deviations of the estimate.
        blocks: Number of blocks that determined the width.
        seconds: Length of a block, s; 0 where each is a single shape.
    """

    level: float
    sigmas: float
    blocks: int
    seconds: float
