"""A robot in slow motion: one static shape after another, continuous in time."""

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
    """Static shapes at several times, with a cubic spline of their strains between.

    Before the first time and after the last the robot holds still.

    Attributes:
        rod: The rod of all shapes.
        mesh: Their Gauss points.
        time: Times of the shapes (K,), s.
        strain: Their strains at the points (K, G, 6).
        rests: Those of the times at which the robot is at rest (B,), s; each stretch between two of
            them has a spline of its own.
    """

    rod: Rod
    mesh: Mesh
    time: Array
    strain: Array
    rests: Array

    def at(self, arclength: ArrayLike, time: ArrayLike) -> Section:
        """Cross-sections at arclengths (m) and times (s), which broadcast together.

        Raises SimulationError off the rod.
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
    """How much shorter (M, T) channels are under strains (M, G, 6) than in the straight rod, m.

    What servos pull in of tendons that do not stretch. Source: (M5).
    """
    points, columns = mesh.points, []
    for tendon in tendons:
        place, slope = tendon.path(points)
        along = strain[..., :3] + np.cross(strain[..., 3:], place) + slope
        straight = np.linalg.norm(STRAIGHT[:3] + slope, axis=-1)
        lost = straight - np.linalg.norm(along, axis=-1)
        columns.append(lost @ (mesh.weights * (points < tendon.end)))
    return np.stack(columns, axis=-1)


def solve_motion(
    rod: Rod,
    tendons: Sequence[Tendon],
    loads_at: Callable[[float], Loads],
    time: ArrayLike,
    rests: ArrayLike,
) -> Motion:
    """The shapes under loads that change slowly, each solved from the one before.

    Args:
        rod: The rod.
        tendons: Its tendons.
        loads_at: The loads at a time in seconds.
        time: Times of the shapes (K,), s.
        rests: Times at which the loads stop changing (B,), s; some of `time`, with its first and
            last.

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
