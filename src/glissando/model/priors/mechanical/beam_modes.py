"""Bending modes of a clamped rod, and how nodes of arclength represent motion in them.

Modes are Rayleigh–Ritz approximations over polynomials s² Pₖ(s), normalised so that ∫ρA b² ds, the
tool's mass included, is one. They are functions of arclength: one amplitude is a vector of the
world frame. Source: equation (32).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import Legendre, leggauss

from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics

_SPARE = 8  # polynomials beyond the modes that are asked for
_PIECES = 12  # of the rod, besides those of its segments, to integrate over


@dataclass(frozen=True)
class BeamModes:
    """The lowest bending modes of a rod on its arclength nodes.

    Attributes:
        rate: Angular frequencies ω (m,), rad/s.
        shape: Their values (N, m) at the nodes that fit them best between the nodes, 1/√kg.
        by_place: Weights (m, N) of positions in the amplitudes y = ∫ρA b p ds.
        by_tangent: Weights (m, N) of tangents.
        at_tip: Values (m,) at the tip, and slopes (m,) there.
        load: What loads make of the amplitudes' accelerations: covariance (m, m).
        length: Of the rod, m.
        ritz: Weights (P, m) of polynomials in the modes.
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
        """Values (M, m) at arclengths (M,), 1/√kg, and slopes by arclength."""
        value, slope, _ = _polynomials(arclength, self.length, len(self.ritz))
        return value @ self.ritz, slope @ self.ritz

    @property
    def fit(self) -> Array:
        """Amplitudes (m, N) of values at the nodes."""
        return np.asarray(np.linalg.pinv(self.shape), dtype=float)

    @property
    def remainder(self) -> Array:
        """Directions (N − m, N) of nodal values that no mode has."""
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
        mechanics: What the rod is made of.
        arclength: The nodes; `count` of them at least beside the base.
        count: How many modes.
        var_load: Density of unknown forces along the rod, N²/m, and variance of that at the tip.
        points: Places (P,) of point loads and variances (P,) of their forces.
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
    """s² Pₖ(s), first and second derivatives (M, count), clamped at zero."""
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
    """Cubics by places and tangents, and hats (G, N), of the nodes at points (G,)."""
    lower = np.clip(np.searchsorted(arclength, s, side="right") - 1, 0, arclength.size - 2)
    h, row = np.diff(arclength)[lower], np.arange(s.size)
    u = (s - arclength[lower]) / h
    place, tangent, hat = np.zeros((3, s.size, arclength.size))
    place[row, lower], place[row, lower + 1] = 1 - 3 * u**2 + 2 * u**3, 3 * u**2 - 2 * u**3
    tangent[row, lower], tangent[row, lower + 1] = h * (u - 2 * u**2 + u**3), h * (u**3 - u**2)
    hat[row, lower], hat[row, lower + 1] = 1 - u, u
    return (place, tangent), hat
