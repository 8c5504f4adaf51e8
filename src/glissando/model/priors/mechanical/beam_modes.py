"""Bending modes of a clamped rod, and their amplitudes from states at arclength nodes.

Modes are Rayleigh–Ritz approximations over polynomials s² Pₖ(s), normalised so that ∫ρA b² ds, the
tool's mass included, is one. They are functions of arclength; an amplitude is a vector in the
world frame. Source: equation (32).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import Legendre, leggauss

from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics

_SPARE = 8  # polynomials in excess of the number of modes
_PIECES = 12  # of the rod for quadrature, besides segments and node intervals


@dataclass(frozen=True)
class BeamModes:
    """The lowest bending modes of a rod on its arclength nodes.

    Attributes:
        rate: Angular frequencies ω (m,), rad/s.
        shape: Nodal values (N, m) whose linear interpolation fits the modes best, 1/√kg.
        by_place: Weights (m, N) of nodal positions in the amplitudes y = ∫ρA b p ds.
        by_tangent: Weights (m, N) of nodal tangents in the amplitudes.
        at_tip: Values (m,) of the modes at the tip, 1/√kg.
        load: Covariance (m, m) of the amplitudes' accelerations due to unknown loads.
        length: Length of the rod, m.
        ritz: Coefficients (P, m) of the modes in the polynomials.
    """

    rate: Array
    shape: Array
    by_place: Array
    by_tangent: Array
    at_tip: Array
    load: Array
    length: float
    ritz: Array

    def at(self, arclength: Array) -> tuple[Array, Array]:
        """Values (M, m) at arclengths (M,), 1/√kg, and derivatives by arclength."""
        value, slope, _ = _polynomials(arclength, self.length, len(self.ritz))
        return value @ self.ritz, slope @ self.ritz

    @property
    def fit(self) -> Array:
        """Matrix (m, N) from nodal values to amplitudes, by least squares."""
        return np.asarray(np.linalg.pinv(self.shape), dtype=float)

    @property
    def remainder(self) -> Array:
        """Orthonormal directions (N − m, N) of nodal values that no mode contains."""
        return scipy.linalg.null_space(self.shape.T).T


def beam_modes(
    mechanics: Mechanics,
    arclength: Array,
    count: int,
    var_load: tuple[float, float],
    points: tuple[Array, Array],
) -> BeamModes:
    """The lowest `count` modes on arclength nodes (N,).

    Args:
        mechanics: Stiffness, mass and tool of the rod.
        arclength: Arclength nodes, m; at least `count` of them besides the base.
        count: Number of modes.
        var_load: Density of unknown forces along the rod, N²/m, and variance at the tip, N².
        points: Arclengths (P,) of point loads, m, and variances (P,) of their forces, N².
    """
    length = float(arclength[-1])
    even = np.linspace(0.0, length, _PIECES + 1)
    s, weight = _quadrature(np.unique(np.concatenate([even, mechanics.joints, arclength])))
    segment = mechanics.segment(s)
    value, _, bend = _polynomials(s, length, count + _SPARE)
    tip = _polynomials(arclength[-1:], length, count + _SPARE)[0]
    mass = weight * mechanics.mass_per_length[segment]
    bending = weight * mechanics.stiffness[segment, 3:5].mean(axis=1)
    inertia = (value * mass[:, None]).T @ value + mechanics.tip_mass * tip.T @ tip
    square, ritz = scipy.linalg.eigh((bend * bending[:, None]).T @ bend, inertia)
    ritz = ritz[:, :count]
    modes, at_tip = value @ ritz, (tip @ ritz)[0]
    hermite, hat = _nodal(arclength, s)
    weighted = (modes * mass[:, None]).T
    by_place, by_tangent = (weighted @ part for part in hermite)
    by_place[:, -1] += mechanics.tip_mass * at_tip
    inner = (hat * mass[:, None]).T @ hat
    mixed = hat.T @ weighted.T
    inner[-1, -1] += mechanics.tip_mass
    mixed[-1] += mechanics.tip_mass * at_tip
    shape = np.zeros((arclength.size, count))
    shape[1:] = np.linalg.solve(inner[1:, 1:], mixed[1:])
    load = var_load[0] * (modes * weight[:, None]).T @ modes
    load += var_load[1] * np.outer(at_tip, at_tip)
    for place, variance in zip(*points, strict=True):
        at_place = (_polynomials(np.array([place]), length, count + _SPARE)[0] @ ritz)[0]
        load += variance * np.outer(at_place, at_place)
    weights = shape, by_place, by_tangent, at_tip, load
    return BeamModes(np.sqrt(square[:count]), *weights, length, ritz)


def _quadrature(edges: Array) -> tuple[Array, Array]:
    """Gauss points and weights (G,) of the intervals between edges."""
    x, w = leggauss(8)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (x + 1.0)).ravel(), (half * w).ravel()


def _polynomials(s: Array, length: float, count: int) -> tuple[Array, Array, Array]:
    """s² Pₖ(s) and its first and second derivatives (M, count): clamped at s = 0."""
    clamped = Legendre([1 / 3, 1 / 2, 1 / 6])  # (1 + z)² / 4 for z from −1 to 1
    each = [clamped * Legendre.basis(k) for k in range(count)]
    z = 2.0 * s / length - 1.0
    derivatives = (
        np.stack([(p.deriv(k) if k else p)(z) * (2.0 / length) ** k for p in each], axis=-1)
        for k in range(3)
    )
    value, slope, bend = derivatives
    return value, slope, bend


def _nodal(arclength: Array, s: Array) -> tuple[tuple[Array, Array], Array]:
    """Hermite cubics of nodal positions and tangents, and hat functions, at points (G, N)."""
    lower = np.clip(np.searchsorted(arclength, s, side="right") - 1, 0, arclength.size - 2)
    h, row = np.diff(arclength)[lower], np.arange(s.size)
    u = (s - arclength[lower]) / h
    place, tangent, hat = np.zeros((3, s.size, arclength.size))
    place[row, lower], place[row, lower + 1] = 1 - 3 * u**2 + 2 * u**3, 3 * u**2 - 2 * u**3
    tangent[row, lower], tangent[row, lower + 1] = h * (u - 2 * u**2 + u**3), h * (u**3 - u**2)
    hat[row, lower], hat[row, lower + 1] = 1 - u, u
    return (place, tangent), hat
