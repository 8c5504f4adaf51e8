"""Consistency of an estimate: NEES and coverage, with their bounds for a true covariance.

Neighbouring errors are correlated, so a thousand samples may be worth ten independent ones. All
bounds are for the effective number of samples, see `effective_samples`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.given import require_list
from glissando.estimation.posterior import Posterior
from glissando.evaluation.effective_samples import effective_errors, effective_samples
from glissando.evaluation.metrics import Errors, innovations
from glissando.geometry.se3 import Array
from glissando.model.quantiles import binomial_quantile, chi_square_of, chi_square_quantile
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.short_repr import ShortRepr

LEVELS = (0.5, 0.9, 0.95, 0.99)
"""Nominal coverages in reports."""


@dataclass(frozen=True)
class Consistency(ShortRepr):
    """Normalised errors of one quantity at one site, or at all sites.

    Attributes:
        site: Name of the stream, or 'all'.
        arclength: Mean arclength of the site, m; NaN for all sites.
        quantity: 'position', 'rotation', 'innovation', or the kind of prediction of `leave_out`.
        nees: Squared errors (M,) in units of their covariance.
        dof: Degrees of freedom of each squared error.
        effective: Effective number of independent samples.
    """

    site: str
    arclength: float
    quantity: str
    nees: Array
    dof: int
    effective: float

    @property
    def mean(self) -> float:
        """Mean NEES per degree of freedom; its expectation is 1 if the covariance is true."""
        return float(np.mean(self.nees)) / self.dof

    def mean_bounds(self, level: float = 0.95) -> tuple[float, float]:
        """Two-sided χ² bounds of `mean`, kept with probability `level` for a true covariance."""
        _require_share(level)
        freedom = self.effective * self.dof
        tail = 0.5 * (1.0 - level)
        low, high = chi_square_quantile([tail, 1.0 - tail], freedom) / freedom
        return float(low), float(high)

    def coverage(self, nominal: float) -> float:
        """Share of samples inside the ellipsoid of nominal coverage `nominal`, in (0, 1)."""
        _require_share(nominal)
        return float(np.mean(self.nees <= chi_square_quantile(nominal, self.dof)))

    def coverage_bounds(self, nominal: float, level: float = 0.95) -> tuple[float, float]:
        """Bounds of `coverage`, kept with probability ≥ `level` for a true covariance."""
        _require_share(nominal)
        _require_share(level)
        count = max(1, round(self.effective))
        tail = 0.5 * (1.0 - level)
        low, high = binomial_quantile([tail, 1.0 - tail], count, nominal) / count
        return float(low), float(high)

    @property
    def verdict(self) -> str:
        """'true' if the mean is within its bounds, else 'overconfident' or 'underconfident'."""
        low, high = self.mean_bounds()
        if self.mean > high:
            return "overconfident"
        return "underconfident" if self.mean < low else "true"

    def as_json(self) -> dict[str, Any]:
        """The statistics with their bounds, as a JSON object."""
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


def _require_share(share: float) -> None:
    if not 0.0 < share < 1.0:
        raise GlissandoError(f"A share of {share:g} cannot be; give 0.95 for 95 %.")


def check(errors: Sequence[Errors]) -> list[Consistency]:
    """Consistency of position and rotation at every site, then of all sites together.

    Errors of different sites are correlated, so all sites together have the mean effective number
    of samples of a site.

    Args:
        errors: Errors of each site.
    """
    require_list(errors, Errors, "errors")
    out = []
    for quantity in ("position", "rotation"):
        sites = [c for e in errors if (c := _at_site(e, quantity)) is not None]
        out += sites
        if len(sites) > 1:
            dof = max(c.dof for c in sites)
            nees = np.concatenate([chi_square_of(c.nees, c.dof, dof) for c in sites])
            effective = float(np.mean([c.effective for c in sites]))
            out.append(Consistency("all", float("nan"), quantity, nees, dof, effective))
    return out


def check_readings(
    posterior: Posterior,
    readings: Sequence[Readings],
    sensor_parameters: Sequence[SensorParameter] = (),
) -> list[Consistency]:
    """Consistency of the innovations of every stream that was used and reads one state at a time.

    Args:
        posterior: The estimate.
        readings: Streams used by the estimate. Outliers count in full, whatever the stream's loss.
        sensor_parameters: Sensor parameters of the robot; the known ones are applied.
    """
    known = [parameter for parameter in sensor_parameters if parameter.known]
    return [
        _consistency(r.label, r.arclength, "innovation", innovations(posterior, r), r.row_count)
        for r in (corrected(r, known) for r in readings)
        if len(r) and r.reads_one_state
    ]


def _at_site(errors: Errors, quantity: str) -> Consistency | None:
    nees: Array = getattr(errors, f"nees_{quantity}")
    nees = nees[~np.isnan(nees)]
    if nees.size == 0:
        return None
    dof = errors.dof_rotation if quantity == "rotation" else 3
    white = getattr(errors, f"white_{quantity}")
    effective = effective_samples(nees)
    if len(white) == nees.size:
        effective = min(effective, effective_errors(white))
    place = float(np.mean(errors.arclength))
    return Consistency(errors.name, place, quantity, nees, dof, effective)


def _consistency(site: str, arclength: Array, quantity: str, nees: Array, dof: int) -> Consistency:
    place = float(np.mean(arclength))
    return Consistency(site, place, quantity, nees, dof, effective_samples(nees))
