"""Forces on the robot as arrows with confidence ellipsoids, for figures, films and pages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.estimation.loads import load_places
from glissando.estimation.posterior import Posterior
from glissando.geometry.covariance import half_axes
from glissando.geometry.se3 import Array
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.visualization.canvas import MM

FORCE = "#CC79A7"
"""Colour of arrows where colour has no other meaning."""
_SHARE = 0.15  # length of the legend's reference arrow, as a fraction of the robot's length
_HEAD, _BARB = 0.2, 0.07  # length and half-width of an arrow's head, as fractions of its length
_AROUND = np.linspace(0.0, 2.0 * np.pi, 33)


@dataclass(frozen=True)
class Arrows:
    """Estimated forces at F times and P arclengths, world frame.

    Attributes:
        place: Arclengths (P,), m.
        origin: Points of application (F, P, 3), m.
        force: Means (F, P, 3), N.
        cov: Covariances (F, P, 3, 3), N².
        unit: Force that an arrow of `length` represents, N.
        length: Length of that arrow in the picture, m.
    """

    place: Array
    origin: Array
    force: Array
    cov: Array
    unit: float
    length: float

    @property
    def words(self) -> str:
        """Legend of arrows and ellipsoids."""
        return f"force, 95 % ({MM * self.length:.3g} mm: {self.unit:g} N)"

    @property
    def scale(self) -> float:
        """Length in the picture per force, m/N."""
        return self.length / self.unit

    @property
    def tip(self) -> Array:
        """Tips of the arrows (F, P, 3), m."""
        return self.origin + self.scale * self.force

    def strokes(self) -> Array:
        """Arrows as lines (F, P, S, 3), m, with a NaN after each line."""
        way, tip = self.scale * self.force, self.tip
        across = np.cross(way, np.where(np.abs(way[..., :1]) < np.abs(way[..., 1:2]),
                                        [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))  # fmt: skip
        size = np.linalg.norm(way, axis=-1, keepdims=True)
        across *= size / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-300)
        neck, gap = tip - _HEAD * way, np.full_like(tip, np.nan)
        parts = [self.origin, tip]
        for side in (across, np.cross(way, across) / np.maximum(size, 1e-300)):
            parts += [gap, neck + _BARB * side, tip, neck - _BARB * side]
        return np.stack([*parts, gap], axis=-2)

    def rings(self) -> Array:
        """Principal ellipses of the 95 % ellipsoids (F, P, S, 3), m, with a NaN after each."""
        axes = SIGMAS_95 * self.scale * half_axes(self.cov)
        tip, lines = self.tip[..., None, :], []
        for i, j in ((0, 1), (1, 2), (2, 0)):
            ring = np.cos(_AROUND)[:, None] * axes[..., None, :, i]
            lines += [tip + ring + np.sin(_AROUND)[:, None] * axes[..., None, :, j]]
            lines.append(np.full_like(tip, np.nan))
        return np.concatenate(lines, axis=-2)


def arrows_of(posterior: Posterior, times: Array) -> Arrows | None:
    """Estimated forces at the tip and at the prior's points; None unless it has loads.

    Args:
        posterior: Estimate, whose forces are taken at the nearest time nodes.
        times: Times (F,), s.
    """
    prior, grid = posterior.prior, posterior.grid
    if not isinstance(prior, MechanicalPrior):
        return None
    place = load_places(prior, grid)
    load = posterior.load(place, times[:, None], frame="world")
    cov = load.cov[..., :3, :3]
    std = np.sqrt(np.maximum(np.linalg.eigvalsh(cov)[..., -1], 0.0))
    sizes = np.linalg.norm(load.force, axis=-1).max(), SIGMAS_95 * np.median(std), 1e-12
    largest = float(max(sizes))
    power = 10.0 ** np.floor(np.log10(largest))
    unit = float(f"{power * max(n for n in (1, 2, 5) if n * power <= largest * (1 + 1e-9)):.1g}")
    length = _SHARE * float(np.ptp(grid.arclength))
    origin = posterior.at(place, times[:, None]).position
    return Arrows(place, origin, load.force, cov, unit, length)
