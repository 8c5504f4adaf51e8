"""Implicit Runge–Kutta methods by collocation, as they are used on an equation of second order.

Radau's points end with the step: the method is of order 2 s − 1, and damps what a step cannot
resolve. Gauss's points give order 2 s and keep quadratic energies for ever. Source: Hairer and
Wanner 1996, sections IV.5 and IV.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from glissando.geometry.se3 import Array

_RADAU = np.array([(4.0 - np.sqrt(6.0)) / 10.0, (4.0 + np.sqrt(6.0)) / 10.0, 1.0])
_GAUSS = 0.5 * (1.0 + legendre.leggauss(3)[0])


@dataclass(frozen=True)
class Collocation:
    """A method with stages at `nodes` (s,) of a step; A (s, s) and b (s,) integrate from its start.

    `values` (s,) and `modes` (s, s) are the eigenvalues and eigenvectors of A.
    """

    nodes: Array
    A: Array
    b: Array
    values: Array
    modes: Array

    @staticmethod
    def at(nodes: Array) -> Collocation:
        """The method that collocates at the given nodes."""
        powers = np.arange(nodes.size)
        to_modes = np.linalg.inv(nodes[:, None] ** powers)
        A = (nodes[:, None] ** (powers + 1) / (powers + 1)) @ to_modes
        b = (1.0 / (powers + 1)) @ to_modes
        values, modes = np.linalg.eig(A)
        return Collocation(nodes, A, b, values, modes)

    def extrapolate(self, places: Array) -> Array:
        """Matrix (P, s) from values at the nodes to those at other places (P,) of the step."""
        powers = np.arange(self.nodes.size)
        matrix: Array = (places[:, None] ** powers) @ np.linalg.inv(self.nodes[:, None] ** powers)
        return matrix


METHODS = {"radau": Collocation.at(_RADAU), "gauss": Collocation.at(_GAUSS)}
"""Methods of three stages by name."""
