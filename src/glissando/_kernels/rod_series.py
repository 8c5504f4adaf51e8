"""Strain, wrench and weight along a loaded rod, as series in arclength, and their Jacobians.

Vectors are rows of one array; their Jacobians, by [weight, force, moment] where a step begins, are
the same rows of another. Both are passed whole with row numbers, since a view of an array inside a
kernel costs as much as a cross product. Source: docs/math.md, equation (26).
"""

from __future__ import annotations

from glissando._kernels.jit import jit

ORDERS = 4  # of a series: a quantity and three derivatives by arclength
ALONG, TURN, FORCE, MOMENT, WEIGHT = range(0, 5 * ORDERS, ORDERS)  # first rows of series


@jit()
def cross(x, a, b, factor, c):
    """Add a multiple of the vector a × b to c."""
    x[c, 0] += factor * (x[a, 1] * x[b, 2] - x[a, 2] * x[b, 1])
    x[c, 1] += factor * (x[a, 2] * x[b, 0] - x[a, 0] * x[b, 2])
    x[c, 2] += factor * (x[a, 0] * x[b, 1] - x[a, 1] * x[b, 0])


@jit()
def cross_slopes(x, a, slopes, b, factor, c):
    """Add a multiple of the vector a × each column of the Jacobian b to the Jacobian c."""
    u, v, w = factor * x[a, 0], factor * x[a, 1], factor * x[a, 2]
    for j in range(9):
        p, q, r = slopes[b, 0, j], slopes[b, 1, j], slopes[b, 2, j]
        slopes[c, 0, j] += v * r - w * q
        slopes[c, 1, j] += w * p - u * r
        slopes[c, 2, j] += u * q - v * p


@jit()
def turn_slopes(matrix, first, slopes, b, c):
    """Add a part (3, 3) of a matrix from column `first` on times Jacobian b to Jacobian c."""
    for i in range(3):
        u, v, w = matrix[i, first], matrix[i, first + 1], matrix[i, first + 2]
        for j in range(9):
            slopes[c, i, j] += u * slopes[b, 0, j] + v * slopes[b, 1, j] + w * slopes[b, 2, j]


@jit()
def series_into(stiffness, rest, rest_slope, x, slopes):
    """Fill in strain, wrench and weight with three derivatives by arclength, and Jacobians.

    Force, moment and weight of order 0 are given. ∂W/∂s = ad(ε)ᵀ W − w_g and ∂w_g/∂s = −u × w_g are
    differentiated by Leibniz' rule.
    """
    for order in range(ORDERS):
        for i in range(3):
            v = rest[i] if order == 0 else rest_slope[i] if order == 1 else 0.0
            u = rest[3 + i] if order == 0 else rest_slope[3 + i] if order == 1 else 0.0
            by_force, by_moment = 1.0 / stiffness[i], 1.0 / stiffness[3 + i]
            x[ALONG + order, i] = v + by_force * x[FORCE + order, i]
            x[TURN + order, i] = u + by_moment * x[MOMENT + order, i]
            for j in range(9):
                slopes[ALONG + order, i, j] = by_force * slopes[FORCE + order, i, j]
                slopes[TURN + order, i, j] = by_moment * slopes[MOMENT + order, i, j]
        n = order + 1
        if n == ORDERS:
            break
        for i in range(3):
            x[FORCE + n, i] = -x[WEIGHT + order, i]
            x[MOMENT + n, i] = x[WEIGHT + n, i] = 0.0
            for j in range(9):
                slopes[FORCE + n, i, j] = -slopes[WEIGHT + order, i, j]
                slopes[MOMENT + n, i, j] = slopes[WEIGHT + n, i, j] = 0.0
        for k in range(n):
            times, j = 2.0 if order == 2 and k == 1 else 1.0, order - k
            for a, b, c in (
                (TURN, FORCE, FORCE), (ALONG, FORCE, MOMENT), (TURN, MOMENT, MOMENT),
                (TURN, WEIGHT, WEIGHT),
            ):  # fmt: skip
                cross(x, a + k, b + j, -times, c + n)
                cross_slopes(x, a + k, slopes, b + j, -times, c + n)
                cross_slopes(x, b + j, slopes, a + k, times, c + n)
