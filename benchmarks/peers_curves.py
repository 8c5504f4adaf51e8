"""Interpolating curves through readings without a robot model, as baselines."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import least_squares

from glissando.geometry import se3
from glissando.model.priors.rest_shape import STRAIGHT


def knots(problem, shape):
    """Arclengths (R,) and poses (R, 4, 4) of a curve's knots, the base first."""
    mine = problem.reading_shape == shape
    s, pose = problem.reading_arclength[mine], problem.reading_pose[mine]
    if problem.base_std:
        s, pose = np.append(0.0, s), np.concatenate([problem.base_pose[None], pose])
    return s, pose


def hermite(s, pose, at):
    """Cubic Hermite curve through positions and tangents."""
    return CubicHermiteSpline(s, pose[:, :3, 3], pose[:, :3, 2])(at)


def spline(s, pose, at):
    """Cubic spline through positions, clamped to the base's tangent and natural at the end."""
    return CubicSpline(s, pose[:, :3, 3], bc_type=((1, pose[0, :3, 2]), (2, np.zeros(3))))(at)


def between(s, pose, at):
    """Poses (M, 4, 4) and strains (M, 6) of piecewise constant strain between readings."""
    k = np.clip(np.searchsorted(s, at, "right") - 1, 0, s.size - 2)
    strain = se3.log(se3.inverse(pose[k]) @ pose[k + 1]) / (s[k + 1] - s[k])[:, None]
    return pose[k] @ se3.exp((at - s[k])[:, None] * strain), strain


def arcs(s, pose, at):
    """Piecewise constant strain between readings: helices, or arcs without twist and shear."""
    return between(s, pose, at)[0][:, :3, 3]


def one_arc(s, pose, at):
    """Single arc from the base whose curvature fits all positions best."""

    def along(bend, where):
        strain = np.concatenate([STRAIGHT[:3], bend, [0.0]])
        return (pose[0] @ se3.exp(where[:, None] * strain))[:, :3, 3]

    found = least_squares(lambda bend: (along(bend, s) - pose[:, :3, 3]).ravel(), np.zeros(2))
    return along(found.x, at)


CURVES = {
    "cubic Hermite curves": hermite,
    "cubic spline": spline,
    "constant curvature by pieces": arcs,
    "one arc": one_arc,
}


def solve(problem, curve):
    """Positions (M, 3) of a curve at the problem's queries."""
    place = np.empty((problem.query_shape.size, 3))
    for shape in range(problem.count):
        rows = problem.query_shape == shape
        place[rows] = CURVES[curve](*knots(problem, shape), problem.query_arclength[rows])
    return place
