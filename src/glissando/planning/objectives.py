"""Objectives: the uncertainty of a zone as a scalar, with its gradient by the covariance.

An objective takes covariances C (Z, p, p) of the pose at a zone's points, in the body frame, and
weights (Z,) that add up to one. It returns its value J and the gradient M (Z, p, p) with
dJ = Σ tr(M dC). The position comes first in a pose, so p = 3 suffices for an objective of the
position alone. Every objective increases with the covariance. Source: equation (23).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import erfc

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.field_checks import is_number

_POLAR, _AROUND = 24, 32  # quadrature points in height and azimuth over a half sphere


class Objective(Protocol):
    """Uncertainty of a zone's points, and its gradient."""

    @property
    def rows(self) -> int:
        """Number p of pose components used: 3 for the position, 6 with the rotation."""

    def __call__(self, cov: Array, weight: Array) -> tuple[float, Array]:
        """Value and gradient (Z, p, p) at covariances (Z, p, p) with weights (Z,)."""


@dataclass(frozen=True)
class Trace:
    """Mean total variance of position, m², plus `lever`² times that of rotation, if not 0.

    >>> Trace()(np.eye(3)[None], np.ones(1))[0]
    3.0
    """

    lever: float = 0.0

    @property
    def rows(self) -> int:
        """Number of pose components used: 3, or 6 with a lever."""
        return 6 if self.lever else 3

    def __call__(self, cov: Array, weight: Array) -> tuple[float, Array]:
        """Σ w tr(C), with rotations weighted by the lever's square, and its gradient."""
        scale = np.repeat([1.0, self.lever**2], 3)[: self.rows]
        gradient = weight[:, None, None] * np.diag(scale)
        return float(np.einsum("z,zii,i->", weight, cov, scale)), gradient


@dataclass(frozen=True)
class LogDet:
    """Mean log-determinant of the position's covariance: twice its log-volume."""

    rows: int = 3

    def __post_init__(self) -> None:
        _require_rows(self.rows)

    def __call__(self, cov: Array, weight: Array) -> tuple[float, Array]:
        """Σ w log det C, with gradient w C⁻¹."""
        value = float(np.sum(weight * np.linalg.slogdet(cov)[1]))
        return value, weight[:, None, None] * np.linalg.inv(cov)


@dataclass(frozen=True)
class Worst:
    """Largest variance in any direction at any point of the zone, m², as a power mean.

    The mean (Σ w tr(Cᵖ))^(1/p), p the `power`, is differentiable even where directions or points
    tie. It exceeds the largest variance by a factor of at most 3^(1/p), and with Z points of equal
    weight falls short of it by a factor of at most Z^(1/p).
    """

    power: int = 16
    rows: int = 3

    def __post_init__(self) -> None:
        _require_rows(self.rows)
        if not isinstance(self.power, int) or self.power < 1:
            raise GlissandoError(f"A power of {self.power!r} cannot be; give a whole one from 1.")

    def __call__(self, cov: Array, weight: Array) -> tuple[float, Array]:
        """The p-norm, with gradient w C^(p−1) J^(1−p)."""
        scale = float(np.einsum("zii->z", cov).max())
        part = np.linalg.matrix_power(cov / scale, self.power - 1)
        total = float(np.einsum("z,zij,zji->", weight, part, cov / scale))
        value = total ** (1.0 / self.power)
        return scale * value, weight[:, None, None] * part * value ** (1 - self.power)


@dataclass(frozen=True)
class Chance:
    """Mean probability that the position error exceeds a `bound` b, m.

    The error is ρ C^½ n with n uniform on the sphere and ρ² χ²-distributed with 3 degrees of
    freedom, so that P = E_n[P(χ²₃ > b² / nᵀCn)]. Quadrature over 24 × 32 directions errs by about
    1e-5, and by up to 1e-3 where one axis is a hundred times wider than both others.

    Raises:
        GlissandoError: The bound is not positive.
    """

    bound: float
    rows: int = 3

    def __post_init__(self) -> None:
        if not (is_number(self.bound) and 0.0 < self.bound < np.inf):
            bound = repr(self.bound).removesuffix(".0")
            raise GlissandoError(f"A bound of {bound} m cannot be; give one above zero.")

    def __call__(self, cov: Array, weight: Array) -> tuple[float, Array]:
        """Σ w P; gradient w E_n[f(y) y/q n nᵀ] with q = nᵀCn, y = b²/q, f the density of χ²₃."""
        n, share = _directions()
        variance = np.einsum("di,zij,dj->zd", n, cov, n)
        y = self.bound**2 / variance
        beyond = erfc(np.sqrt(0.5 * y)) + np.sqrt(2.0 * y / np.pi) * np.exp(-0.5 * y)
        density = np.sqrt(y / (2.0 * np.pi)) * np.exp(-0.5 * y)
        gradient = np.einsum("z,d,zd,di,dj->zij", weight, share, density * y / variance, n, n)
        return float(np.einsum("z,d,zd->", weight, share, beyond)), gradient


def _require_rows(rows: int) -> None:
    if rows not in (3, 6):
        raise GlissandoError(f"An objective of {rows!r} rows cannot be; give 3, or 6 of a pose.")


def _directions() -> tuple[Array, Array]:
    """Directions (D, 3) over a half sphere about body z, and their weights (D,)."""
    height, share = np.polynomial.legendre.leggauss(_POLAR)
    height, share = 0.5 * (height + 1.0), 0.5 * share / _AROUND
    angle = 2.0 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
    radius = np.sqrt(1.0 - height**2)[:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = np.broadcast_to(height[:, None], x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), np.repeat(share, _AROUND)


OBJECTIVES: dict[str, Callable[..., Objective]] = {
    "trace": Trace, "logdet": LogDet, "max": Worst, "chance": Chance,
}  # fmt: skip
"""Objectives by their names on the command line."""


def objective_named(name: str, bound: float = 5e-3, longest: float = np.inf) -> Objective:
    """Create an objective by its name on the command line.

    Args:
        name: One of trace, logdet, max and chance.
        bound: Position error, m, whose probability of being exceeded is the objective chance.
        longest: Largest plausible bound, m, such as the robot's length.

    Raises:
        GlissandoError: There is no objective of this name, or the bound exceeds `longest`.
    """
    if name not in OBJECTIVES:
        raise GlissandoError(
            f"There is no objective {name!r}; choose one of {', '.join(OBJECTIVES)}."
        )
    objective = Chance(bound) if name == "chance" else OBJECTIVES[name]()
    require_objective(objective, longest)
    return objective


def require_objective(objective: Objective, longest: float) -> None:
    """Raise GlissandoError unless this is an objective whose bound is at most `longest`, m."""
    if isinstance(objective, type | str) or not callable(objective):
        raise GlissandoError(
            f"The objective is {objective!r}; give Trace(), LogDet(), Worst() or Chance(0.005), "
            f"or objective_named(…)."
        )
    bound = getattr(objective, "bound", 0.0)
    if bound > longest:
        raise GlissandoError(
            f"A bound of {bound:g} m exceeds the robot's length, {longest:g} m; give metres."
        )
