"""Spectral elements along a rod: integration, interpolation, and integration of strain to poses.

Between discontinuities (a load, a tendon's end) strain is smooth, so a polynomial through the Gauss
points of each element converges spectrally.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import block_diag

from glissando.geometry import se3
from glissando.geometry.se3 import Array

_COUNT = 12  # Gauss points per element
_NODES, _WEIGHTS = legendre.leggauss(_COUNT)
_TO_MODES = np.linalg.inv(legendre.legvander(_NODES, _COUNT - 1))  # values at the points → modes
_SAME = 1e-9  # m: arclengths closer than this are equal
_ENDS = np.concatenate([[-1.0], _NODES, [1.0]])
_INNER = np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])  # the three Gauss points of a Magnus step


def _interpolation(x: Array) -> Array:
    """Matrix (…, 12) from values at an element's points to values at x (…) in [−1, 1]."""
    return legendre.legvander(x, _COUNT - 1) @ _TO_MODES


def _integrals() -> Array:
    """Matrix (12, 12) from values at the points to integrals from −1 to each point."""
    modes = [legendre.legval(_NODES, legendre.legint(row, lbnd=-1)) for row in np.eye(_COUNT)]
    return np.stack(modes, axis=1) @ _TO_MODES


def _magnus_points(ends: Array) -> Array:
    """Matrix (P − 1, 3, 12) from values at the points to three points between ends (P,)."""
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
    points = middle[:, None] + half[:, None] * _INNER
    return _interpolation(points.ravel()).reshape(*points.shape, _COUNT)


_INTEGRALS, _STEPS = _integrals(), _magnus_points(_ENDS)


def _bracket(x: Array, y: Array) -> Array:
    """Lie bracket (…, 6), with the sign for T′ = T ε^, whose products are in reverse order."""
    return -np.einsum("...ij,...j->...i", se3.ad(x), y)


def magnus(strain: Array, step: Array) -> Array:
    """Sixth-order Magnus twist (…, 6) of a step with strain (…, 3, 6) at its Gauss points.

    Source: Blanes, Casas and Ros 2000.
    """
    first, middle, last = (step * strain[..., i, :] for i in range(3))
    slope, bend = np.sqrt(15.0) / 3.0 * (last - first), 10.0 / 3.0 * (last - 2.0 * middle + first)
    twist = _bracket(middle, slope)
    turn = _bracket(middle, 2.0 * bend + twist) / -60.0
    rest = _bracket(-20.0 * middle - bend + twist, slope + turn) / 240.0
    return middle + bend / 12.0 + rest


@dataclass(frozen=True)
class Mesh:
    """Elements with twelve Gauss points each; `edges` (E + 1,) in metres from 0 to the length.

    An element's points and ends bound 13 intervals of `widths` (E, 13), m; `steps` (13, 3, 12)
    interpolates values at the points to three Gauss points of each interval.
    """

    edges: Array
    points: Array = field(init=False)
    weights: Array = field(init=False)
    widths: Array = field(init=False, repr=False)
    steps: ClassVar[Array] = _STEPS

    def __post_init__(self) -> None:
        middle, half = 0.5 * (self.edges[1:] + self.edges[:-1]), 0.5 * np.diff(self.edges)
        object.__setattr__(self, "points", (middle[:, None] + half[:, None] * _NODES).ravel())
        object.__setattr__(self, "weights", (half[:, None] * _WEIGHTS).ravel())
        object.__setattr__(self, "widths", half[:, None] * np.diff(_ENDS))

    @staticmethod
    def through(breaks: Sequence[float] | Array, largest: float) -> Mesh:
        """Mesh with an edge at each of `breaks` and no element longer than `largest`, m."""
        places = np.unique(breaks)
        places = places[np.append(True, np.diff(places) > _SAME)]
        parts = [
            np.linspace(low, high, int(np.ceil((high - low) / largest - 1e-9)) + 1)[:-1]
            for low, high in pairwise(places)
        ]
        return Mesh(np.append(np.concatenate(parts), places[-1]))

    def has(self, breaks: Sequence[float] | Array) -> bool:
        """Whether the mesh ends at the largest of `breaks` and has an edge at each of them."""
        gaps = np.abs(self.edges[:, None] - np.asarray(breaks)).min(axis=0)
        return bool(np.all(gaps <= _SAME) and abs(self.edges[-1] - np.max(breaks)) <= _SAME)

    @property
    def integral(self) -> Array:
        """Matrix (G, G) from values at the points to integrals from 0 to each point."""
        half = 0.5 * np.diff(self.edges)
        whole = block_diag(*[h * _INTEGRALS for h in half])
        element = np.repeat(np.arange(half.size), _COUNT)
        return whole + (element[:, None] > element[None, :]) * self.weights

    def unresolved(self, strain: Array) -> float:
        """Estimate of the rotation (rad) due to modes of strain that the elements do not resolve.

        Computed from the last two resolved modes, whose integral over an element nearly cancels.
        """
        modes = np.abs(_TO_MODES @ self._split(strain))
        tails = modes[:, -2:].max(axis=(1, 2))
        return float((tails * np.diff(self.edges)).max()) / _COUNT**2

    def element_of(self, arclength: Array) -> np.ndarray:
        """Indices (M,) of the elements that contain arclengths; an edge belongs to the next one."""
        return np.clip(np.searchsorted(self.edges, arclength, "right") - 1, 0, self.edges.size - 2)

    def interpolate(self, values: Array, arclength: Array) -> Array:
        """Values (M, D) at arclengths (M,), each from its own `values` (M, G, D) at the points."""
        element, rows = self.element_of(arclength), np.arange(arclength.size)
        weights = _interpolation(self._local(arclength, element))
        return np.einsum("mi,mid->md", weights, self._split(values)[rows, element])

    def _local(self, arclength: Array, element: np.ndarray) -> Array:
        low, high = self.edges[element], self.edges[element + 1]
        return (2.0 * arclength - low - high) / (high - low)

    def _split(self, values: Array) -> Array:
        return values.reshape(*values.shape[:-2], self.edges.size - 1, _COUNT, values.shape[-1])

    def roll_out(self, strain: Array, base: Array) -> tuple[Array, Array]:
        """Poses at points (…, G, 4, 4) and edges (…, E + 1, 4, 4), integrated from strains."""
        inner = np.einsum("ipn,...enj->...eipj", _STEPS, self._split(strain))
        moves = se3.exp(magnus(inner, self.widths[..., None]))
        elements = self.edges.size - 1
        points = np.empty((*strain.shape[:-2], elements, _COUNT, 4, 4))
        edges = np.empty((*strain.shape[:-2], elements + 1, 4, 4))
        pose = edges[..., 0, :, :] = np.broadcast_to(base, (*strain.shape[:-2], 4, 4))
        for e in range(elements):
            for i in range(_COUNT):
                pose = points[..., e, i, :, :] = pose @ moves[..., e, i, :, :]
            pose = edges[..., e + 1, :, :] = pose @ moves[..., e, _COUNT, :, :]
        return points.reshape(*strain.shape[:-1], 4, 4), edges

    def pose_at(self, strain: Array, edges: Array, arclength: Array) -> Array:
        """Poses (M, 4, 4) at arclengths (M,) of strains (M, G, 6) and edge poses (M, E + 1, 4, 4).

        Strain is integrated from the edge below in four Magnus steps.
        """
        element, rows = self.element_of(arclength), np.arange(arclength.size)
        values, pose = self._split(strain)[rows, element], edges[rows, element]
        ends = np.linspace(-1.0, self._local(arclength, element), 5)  # (5, M)
        half = 0.5 * np.diff(self.edges)[element]
        for low, high in pairwise(ends):
            points = 0.5 * (high + low)[:, None] + 0.5 * (high - low)[:, None] * _INNER
            inner = np.einsum("mpn,mnj->mpj", _interpolation(points), values)
            pose = pose @ se3.exp(magnus(inner, ((high - low) * half)[:, None]))
        return pose
