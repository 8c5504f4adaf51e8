"""Whether confidence is true: normalised errors and coverage, with the bounds honesty would keep.

Errors of neighbouring samples are much alike, so a thousand of them may count as ten. Bounds here
are for the effective number, from the autocorrelation of the normalised errors (Geyer's initial
positive sequence, as in Markov chains).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binom, chi2

from glissando.estimation.posterior import Posterior
from glissando.evaluation.metrics import Errors, innovations
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings

LEVELS = (0.5, 0.9, 0.95, 0.99)
"""Nominal coverages that are judged."""


@dataclass(frozen=True)
class Consistency:
    """Normalised errors of one quantity at one site, or at all of them.

    `nees` (M,) squared errors in units of their covariance, of `dof` degrees of freedom;
    `effective` the number of independent samples they are worth.
    """

    site: str
    arclength: float
    quantity: str
    nees: Array
    dof: int
    effective: float

    @property
    def mean(self) -> float:
        """Mean NEES per degree of freedom; 1 when confidence is true."""
        return float(np.mean(self.nees)) / self.dof

    def mean_bounds(self, level: float = 0.95) -> tuple[float, float]:
        """Two-sided χ² bounds that the mean keeps with probability `level` if it is true."""
        freedom = self.effective * self.dof
        tail = 0.5 * (1.0 - level)
        low, high = chi2.ppf([tail, 1.0 - tail], freedom) / freedom
        return float(low), float(high)

    def coverage(self, nominal: float) -> float:
        """Share of samples inside the ellipsoid that should hold a share `nominal`."""
        return float(np.mean(self.nees <= chi2.ppf(nominal, self.dof)))

    def coverage_bounds(self, nominal: float, level: float = 0.95) -> tuple[float, float]:
        """Bounds that the coverage keeps with probability `level` at least if it is true."""
        count = max(1, round(self.effective))
        tail = 0.5 * (1.0 - level)
        low, high = binom.ppf([tail, 1.0 - tail], count, nominal) / count
        return float(low), float(high)

    @property
    def verdict(self) -> str:
        """'true', or which way the mean leaves its 95 % bounds: 'too sure', 'too unsure'."""
        low, high = self.mean_bounds()
        return "too sure" if self.mean > high else "too unsure" if self.mean < low else "true"

    def as_json(self) -> dict[str, Any]:
        """The numbers, with their bounds."""
        levels = {
            f"{level:g}": {
                "share": self.coverage(level),
                "bounds": list(self.coverage_bounds(level)),
            }
            for level in LEVELS
        }
        return {
            "site": self.site,
            "arclength": None if np.isnan(self.arclength) else self.arclength,
            "quantity": self.quantity,
            "samples": int(self.nees.size),
            "effective_samples": self.effective,
            "nees": self.mean,
            "nees_bounds": list(self.mean_bounds()),
            "coverage": levels,
            "verdict": self.verdict,
        }


def effective_samples(values: Array) -> float:
    """Number of independent samples that a series (M,) is worth, from 1 to M."""
    count = values.size
    centred = values - values.mean()
    if count < 4 or not np.any(np.abs(centred) > 1e-12 * (1.0 + np.abs(values).max())):
        return 1.0
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    rho = np.fft.irfft(np.abs(spectrum) ** 2, size)[:count]
    rho /= rho[0]
    pairs = rho[0 : count - 1 : 2] + rho[1:count:2]
    negative = np.flatnonzero(pairs <= 0.0)
    kept = pairs[: negative[0]] if negative.size else pairs
    return float(np.clip(count / max(2.0 * kept.sum() - 1.0, 1e-12), 1.0, count))


def check(errors: Sequence[Errors]) -> list[Consistency]:
    """Position and rotation at every site, then at all sites together.

    All sites together are worth as many independent samples as one of them on average: they err
    together.
    """
    out = []
    for quantity in ("position", "rotation"):
        found = [c for e in errors if (c := _at_site(e, quantity)) is not None]
        out += found
        if len(found) > 1:
            nees = np.concatenate([c.nees * (3.0 / c.dof) for c in found])
            effective = float(np.mean([c.effective for c in found]))
            out.append(Consistency("all", float("nan"), quantity, nees, 3, effective))
    return out


def check_readings(posterior: Posterior, readings: Sequence[Readings]) -> list[Consistency]:
    """Innovations of every stream that was used: is each as far off as it should be.

    Streams with a robust loss may hold outliers, which count here.
    """
    out = []
    for stream in readings:
        if len(stream):
            nis = innovations(posterior, stream)
            place = float(np.mean(stream.arclength))
            rows = stream.row_count
            name = stream.label
            out.append(Consistency(name, place, "innovation", nis, rows, effective_samples(nis)))
    return out


def _at_site(errors: Errors, quantity: str) -> Consistency | None:
    nees: Array = getattr(errors, f"nees_{quantity}")
    nees = nees[~np.isnan(nees)]
    if nees.size == 0:
        return None
    dof = errors.dof_rotation if quantity == "rotation" else 3
    place = float(np.mean(errors.arclength))
    return Consistency(errors.name, place, quantity, nees, dof, effective_samples(nees))
