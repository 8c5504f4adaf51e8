"""Implicit Runge–Kutta methods by collocation, for equations of second order.

Radau points include the end of the step: the method has order 2 s − 1 and damps modes that a step
does not resolve. Gauss points give order 2 s and conserve quadratic energies. Source: Hairer and
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
    """Method with stages at the fractions `nodes` (s,) of a step and coefficients A (s, s), b (s,).

    `values` (s,) and `modes` (s, s) are the eigenvalues and eigenvectors of A.
    """

    nodes: Array
    A: Array
    b: Array
    values: Array
    modes: Array

    @staticmethod
    def at(nodes: Array) -> Collocation:
        """Method with collocation at the given nodes."""
        powers = np.arange(nodes.size)
        to_modes = np.linalg.inv(nodes[:, None] ** powers)
        A = (nodes[:, None] ** (powers + 1) / (powers + 1)) @ to_modes
        b = (1.0 / (powers + 1)) @ to_modes
        values, modes = np.linalg.eig(A)
        return Collocation(nodes, A, b, values, modes)

    def extrapolate(self, places: Array) -> Array:
        """Matrix (P, s) that interpolates values at the nodes to fractions (P,) of the step."""
        powers = np.arange(self.nodes.size)
        matrix: Array = (places[:, None] ** powers) @ np.linalg.inv(self.nodes[:, None] ** powers)
        return matrix


METHODS = {"radau": Collocation.at(_RADAU), "gauss": Collocation.at(_GAUSS)}
"""Three-stage methods by name."""
