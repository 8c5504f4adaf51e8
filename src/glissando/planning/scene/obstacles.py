"""Obstacles in the world frame: signed distances of points, their slopes and curvatures.

Spheres, capsules and boxes are one thing: a box with rounded edges, of which a sphere's has no size
and a capsule's only a length. A half-space is the other; `mesh` has the third. Distances are
negative inside. Source: the distance to a convex set has slope n = v / |v| for v from its nearest
point, and curvature (I − n nᵀ − A) / |v|, A the projector along the face that this point lies in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from glissando.estimation.confidence_tube import tube_faces
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Index

_TINY = 1e-12
_RINGS = 6  # of a quarter of a surface that is shown

Distances = tuple[Array, Array]
"""Signed distances (M,) and their slopes (M, 3)."""

Surface = tuple[Array, Index]
"""Vertices (V, 3) and triangles (F, 3)."""


class Obstacle(Protocol):
    """Something to keep away from."""

    def distance(self, point: Array) -> Distances:
        """Signed distances of points (M, 3) from the surface, and slopes."""

    def curvature(self, point: Array) -> Array:
        """Curvatures (M, 3, 3) of the distances at points (M, 3)."""

    def surface(self) -> Surface:
        """Its surface as triangles, by which it is shown."""


@dataclass(frozen=True)
class RoundedBox:
    """A box with rounded edges: a sphere without size, a capsule with one, or a plain box.

    Attributes:
        pose: Pose (4, 4) of its middle.
        half: Half its sizes (3,) before rounding, m.
        radius: Radius of the rounding, m.
    """

    pose: Array
    half: Array
    radius: float = 0.0

    def distance(self, point: Array) -> Distances:
        """Signed distances of points (M, 3), and slopes."""
        local, away, size = self._away(point)
        signed, normal = size - self.radius, away / np.maximum(size, _TINY)[:, None]
        inside = np.flatnonzero(size <= _TINY)
        if inside.size:
            depth = self.half - np.abs(local[inside])
            side = np.argmin(depth, axis=-1)
            signed[inside] = -depth[np.arange(inside.size), side] - self.radius
            out = np.where(local[inside] < 0.0, -1.0, 1.0)
            normal[inside] = out * (np.arange(3) == side[:, None])
        return signed, normal @ self.pose[:3, :3].T

    def curvature(self, point: Array) -> Array:
        """Curvatures (M, 3, 3) of the distances at points (M, 3)."""
        turn, (local, away, size) = self.pose[:3, :3], self._away(point)
        normal = away / np.maximum(size, _TINY)[:, None]
        free = (np.abs(local) > self.half).astype(float)
        curved = free[:, :, None] * np.eye(3) - normal[:, :, None] * normal[:, None, :]
        curved[size <= _TINY] = 0.0
        return np.asarray(turn @ (curved / np.maximum(size, _TINY)[:, None, None]) @ turn.T)

    def _away(self, point: Array) -> tuple[Array, Array, Array]:
        """Points (M, 3) in the box's frame, their ways from what is rounded, and lengths."""
        local = (point - self.pose[:3, 3]) @ self.pose[:3, :3]
        away = local - np.clip(local, -self.half, self.half)
        return local, away, np.linalg.norm(away, axis=-1)

    def surface(self) -> Surface:
        """The surface of a ball whose parts are moved to the corners."""
        down, around = np.linspace(0.0, np.pi, 2 * _RINGS), 4 * _RINGS
        turn = 2.0 * np.pi * (np.arange(around) + 0.5) / around
        away = np.stack(
            [np.outer(np.sin(down), np.cos(turn)), np.outer(np.sin(down), np.sin(turn)),
             np.outer(np.cos(down), np.ones(around))], axis=-1,
        ).reshape(-1, 3)  # fmt: skip
        points = np.sign(away) * self.half + self.radius * away
        return points @ self.pose[:3, :3].T + self.pose[:3, 3], tube_faces(2 * _RINGS, around)


def sphere(center: Array, radius: float) -> RoundedBox:
    """A sphere around a centre (3,), m."""
    return RoundedBox(se3.pose(np.eye(3), np.asarray(center)), np.zeros(3), radius)


def capsule(start: Array, end: Array, radius: float) -> RoundedBox:
    """All points within a radius of the line from a start (3,) to an end (3,), m."""
    axis = end - start
    pose = se3.pose(np.eye(3), 0.5 * (start + end))
    size = float(np.linalg.norm(axis))
    if size > 0.0:
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across /= np.linalg.norm(across)
        pose[:3, :3] = np.stack([across, np.cross(axis / size, across), axis / size], axis=-1)
    return RoundedBox(pose, np.array([0.0, 0.0, 0.5 * size]), radius)


@dataclass(frozen=True)
class HalfSpace:
    """All that lies behind a plane.

    Attributes:
        point: A point of the plane (3,), m.
        normal: Unit vector (3,) out of it.
    """

    point: Array
    normal: Array

    def distance(self, point: Array) -> Distances:
        """Signed distances of points (M, 3), and slopes."""
        return (point - self.point) @ self.normal, np.broadcast_to(self.normal, point.shape)

    def curvature(self, point: Array) -> Array:
        """Curvatures (M, 3, 3) of the distances at points (M, 3): none."""
        return np.zeros((*point.shape, 3))

    def surface(self) -> Surface:
        """A square of the plane, 0.2 m wide, about its point."""
        u = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        u *= 0.1 / np.linalg.norm(u)
        v = np.cross(self.normal, u)
        corners = np.array([-u - v, u - v, -u + v, u + v])
        return self.point + corners, np.array([[0, 1, 2], [1, 3, 2]])


def distances(obstacles: Sequence[Obstacle], point: Array) -> Distances:
    """Signed distances (O, M) of points (M, 3) from all obstacles, and slopes."""
    if not obstacles:
        return np.zeros((0, len(point))), np.zeros((0, *point.shape))
    signed, slope = zip(*(obstacle.distance(point) for obstacle in obstacles), strict=True)
    return np.stack(signed), np.stack(slope)
