"""The whole-body tube that a robot file carries: how wide, and what was promised of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tube:
    """A tube around the body that holds all judged places of a block at once.

    A place is inside if its error lies in the ellipsoid of `sigmas` standard deviations of the
    estimate there. The promise needs no model of errors: a further block, exchangeable with the
    `blocks` that the width was chosen on, lies wholly inside with probability `level` at least.
    It speaks of whole blocks, not of samples, and of blocks like those. Source: Vovk, Gammerman and
    Shafer, *Algorithmic Learning in a Random World* (2005), split conformal prediction.

    Attributes:
        level: Probability promised.
        sigmas: Half width, standard deviations of the estimate.
        blocks: How many blocks it was chosen on.
        seconds: Length of a block, s; 0 where each is a single shape.
    """

    level: float
    sigmas: float
    blocks: int
    seconds: float
