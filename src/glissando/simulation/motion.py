"""Quasi-static motion: a sequence of static shapes, interpolated in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from glissando.geometry.se3 import Array
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import STRAIGHT, Loads, Rod, Tendon
from glissando.simulation.shape import Section, Shape, sections
from glissando.simulation.statics import resample, solve_shape

_CHUNK = 500  # queries at a time, to bound memory


@dataclass(frozen=True)
class Motion:
    """Static shapes at several times, with strains interpolated by cubic splines.

    Before the first and after the last time the robot is at rest.

    Attributes:
        rod: Rod of all shapes.
        mesh: Mesh of all shapes, with G points.
        time: Times of the shapes (K,), s.
        strain: Strains at the points (K, G, 6).
        rests: Times (B,) among `time` at which the robot is at rest, s; each interval between two
            of them has its own clamped spline.
    """

    rod: Rod
    mesh: Mesh
    time: Array
    strain: Array
    rests: Array

    def at(self, arclength: ArrayLike, time: ArrayLike) -> Section:
        """Cross-sections at arclengths (m) and times (s), which are broadcast together.

        Raises SimulationError for arclengths off the rod.
        """
        s, t = np.broadcast_arrays(
            np.asarray(arclength, dtype=float), np.asarray(time, dtype=float)
        )
        shape, s, t = s.shape, s.ravel(), np.clip(t.ravel(), self.time[0], self.time[-1])
        pose, (strain, wrench) = np.empty((s.size, 4, 4)), np.empty((2, s.size, 6))
        for first in range(0, s.size, _CHUNK):
            rows = slice(first, first + _CHUNK)
            instants, which = np.unique(t[rows], return_inverse=True)
            strains = self.strains(instants)
            edges = self.mesh.roll_out(strains, self.rod.base)[1][which]
            part = sections(self.rod, self.mesh, strains[which], edges, s[rows])
            pose[rows], strain[rows], wrench[rows] = part.pose, part.strain, part.wrench
        return Section(
            pose.reshape(*shape, 4, 4), strain.reshape(*shape, 6), wrench.reshape(*shape, 6)
        )

    def strains(self, time: Array) -> Array:
        """Strains (M, G, 6) at the mesh's points at times (M,), s."""
        time = np.clip(time, self.time[0], self.time[-1])
        if self.time.size == 1:
            return np.broadcast_to(self.strain, (time.size, *self.strain.shape[1:]))
        out = np.empty((time.size, *self.strain.shape[1:]))
        for start, stop in pairwise(np.searchsorted(self.time, self.rests)):
            inside = (time >= self.time[start]) & (time <= self.time[stop])
            knots = slice(start, stop + 1)
            spline = CubicSpline(self.time[knots], self.strain[knots], bc_type="clamped")
            out[inside] = spline(time[inside])
        return out


def shortening(mesh: Mesh, strain: Array, tendons: Sequence[Tendon]) -> Array:
    """Shortening (M, T) of channels under strains (M, G, 6), relative to the straight rod, m.

    Equals the displacements of inextensible tendons. Source: (M5).
    """
    points, columns = mesh.points, []
    for tendon in tendons:
        place, slope = tendon.path(points)
        along = strain[..., :3] + np.cross(strain[..., 3:], place) + slope
        straight = np.linalg.norm(STRAIGHT[:3] + slope, axis=-1)
        shortened = straight - np.linalg.norm(along, axis=-1)
        columns.append(shortened @ (mesh.weights * (points < tendon.end)))
    return np.stack(columns, axis=-1)


def solve_motion(
    rod: Rod,
    tendons: Sequence[Tendon],
    loads_at: Callable[[float], Loads],
    time: ArrayLike,
    rests: ArrayLike,
) -> Motion:
    """Solve the static shapes under slowly changing loads, each from the one before.

    Args:
        rod: The rod.
        tendons: Tendons of the rod.
        loads_at: Function of time (s) that returns the loads.
        time: Times of the shapes (K,), s.
        rests: Times (B,) at which the loads are stationary, s; a subset of `time` that includes the
            first and the last.

    Raises:
        SimulationError: Tendons or loads are impossible.
        NoShapeError: The rod buckles.
    """
    times = np.atleast_1d(np.asarray(time, dtype=float))
    shapes: list[Shape] = []
    for t in times:
        start = shapes[-1] if shapes else None
        shapes.append(solve_shape(rod, tendons, loads_at(float(t)), start=start))
    finest = max((shape.mesh for shape in shapes), key=lambda mesh: mesh.points.size)
    same = [shape.mesh.points.size == finest.points.size for shape in shapes]
    strain = [
        shape.strain if fits else resample(shape.mesh, shape.strain, finest)
        for shape, fits in zip(shapes, same, strict=True)
    ]
    rests = np.atleast_1d(np.asarray(rests, dtype=float))
    return Motion(rod, finest, times, np.array(strain), rests)
