"""Obstacles in the world frame: signed distances of points, with gradients and Hessians.

Spheres, capsules and boxes are all boxes with rounded edges; the box of a sphere has no size, that
of a capsule only a length. Half-spaces and meshes (see `mesh`) are the other kinds. Distances are
negative inside. Source: the distance to a convex set has gradient n = v / |v| for v from its
nearest point, and Hessian (I − n nᵀ − A) / |v|, A the projector along the face of this point.
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
_RINGS = 6  # rings of a displayed surface per quarter turn

Distances = tuple[Array, Array]
"""Signed distances (M,), m, and their gradients (M, 3)."""

Surface = tuple[Array, Index]
"""Vertices (V, 3), m, and triangles (F, 3) as indices of vertices."""


class Obstacle(Protocol):
    """A solid that the robot must not touch."""

    def distance(self, point: Array) -> Distances:
        """Signed distances (M,) of points (M, 3) from the surface, and gradients (M, 3)."""

    def curvature(self, point: Array) -> Array:
        """Hessians (M, 3, 3) of the distance at points (M, 3), 1/m."""

    def surface(self) -> Surface:
        """The surface as triangles, for display."""


@dataclass(frozen=True)
class RoundedBox:
    """A box with rounded edges: a sphere, a capsule or a box, depending on its sizes.

    Attributes:
        pose: Pose (4, 4) of the centre in the world.
        half: Half the sizes (3,) of the box without the rounding, m: (0, 0, 0) for a sphere.
        radius: Radius of the rounding, by which the box grows on all sides, m.
    """

    pose: Array
    half: Array
    radius: float = 0.0

    def distance(self, point: Array) -> Distances:
        """Signed distances (M,) of points (M, 3), and gradients (M, 3)."""
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
        """Hessians (M, 3, 3) of the distance at points (M, 3), 1/m."""
        turn, (local, away, size) = self.pose[:3, :3], self._away(point)
        normal = away / np.maximum(size, _TINY)[:, None]
        free = (np.abs(local) > self.half).astype(float)
        curved = free[:, :, None] * np.eye(3) - normal[:, :, None] * normal[:, None, :]
        curved[size <= _TINY] = 0.0
        return np.asarray(turn @ (curved / np.maximum(size, _TINY)[:, None, None]) @ turn.T)

    def _away(self, point: Array) -> tuple[Array, Array, Array]:
        """Points (M, 3) in the box's frame, offsets (M, 3) from the inner box, and lengths (M,)."""
        local = (point - self.pose[:3, 3]) @ self.pose[:3, :3]
        away = local - np.clip(local, -self.half, self.half)
        return local, away, np.linalg.norm(away, axis=-1)

    def surface(self) -> Surface:
        """Triangles of a ball whose octants are moved to the corners of the inner box."""
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
    """A capsule: all points within a radius of the segment from start (3,) to end (3,), m."""
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
    """The half-space behind a plane.

    Attributes:
        point: A point (3,) of the plane, m.
        normal: Outward unit normal (3,).
    """

    point: Array
    normal: Array

    def distance(self, point: Array) -> Distances:
        """Signed distances (M,) of points (M, 3), and gradients (M, 3)."""
        return (point - self.point) @ self.normal, np.broadcast_to(self.normal, point.shape)

    def curvature(self, point: Array) -> Array:
        """Hessians (M, 3, 3) of the distance at points (M, 3), which are zero."""
        return np.zeros((*point.shape, 3))

    def surface(self) -> Surface:
        """A square of the plane, 0.2 m wide, about its point."""
        u = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        u *= 0.1 / np.linalg.norm(u)
        v = np.cross(self.normal, u)
        corners = np.array([-u - v, u - v, -u + v, u + v])
        return self.point + corners, np.array([[0, 1, 2], [1, 3, 2]])


def distances(obstacles: Sequence[Obstacle], point: Array) -> Distances:
    """Signed distances (O, M) of points (M, 3) from all obstacles, and gradients (O, M, 3)."""
    if not obstacles:
        return np.zeros((0, len(point))), np.zeros((0, *point.shape))
    signed, slope = zip(*(obstacle.distance(point) for obstacle in obstacles), strict=True)
    return np.stack(signed), np.stack(slope)
