"""Meshes as obstacles: signed distance fields on a lattice, from closed surfaces in files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from glissando.errors import GlissandoError, needing
from glissando.geometry.se3 import Array
from glissando.io.plain_file import require_plain
from glissando.model.grid import Index
from glissando.planning.scene.obstacles import Distances, Surface

_KINDS = "stl", "obj", "ply"
_LARGEST, _TRIANGLES = 1 << 26, 200_000  # bytes and triangles of a mesh, at most
_CELLS, _THIN = 24, 6  # lattice cells along the longest side of a mesh, and the thinnest
_POINTS = 100_000  # lattice points at most, approximately
_MARGIN = 0.35  # share of the longest side by which the lattice extends beyond the mesh
_AT_ONCE = 2000  # points per batch of distance queries
_CHECKED = 1000  # points near the surface where the splines are compared with the triangles
_SAFELY = 1.1  # safety factor on the largest overestimate there, which is subtracted everywhere


@dataclass(frozen=True)
class Mesh:
    """A closed surface of triangles, as cubic splines of its signed distances on a lattice.

    `read_mesh` subtracts the largest overestimate of the splines, so the obstacle is slightly too
    thick.

    Attributes:
        low: Lowest corner (3,) of the lattice, world frame, m.
        step: Spacing of the lattice, m.
        values: Signed distances (X, Y, Z) at the lattice points, m; negative inside.
        vertices: Vertices (V, 3) of the surface, world frame, m.
        triangles: Vertex indices (F, 3) of the triangles.
    """

    low: Array
    step: float
    values: Array
    vertices: Array
    triangles: Index

    @cached_property
    def _spline(self) -> Array:
        return np.asarray(spline_filter(self.values, order=3, mode="nearest"))

    def distance(self, point: Array) -> Distances:
        """Signed distances (M,) of points (M, 3), and gradients by differences of the spline.

        Outside the lattice, the distance is to the surface point nearest to the closest lattice
        point.
        """
        inner, beyond, h = self._inner(point)
        f = self._around(inner, h * np.array([[0, 0, 0], *np.eye(3), *-np.eye(3)]))
        slope = (f[:, 1:4] - f[:, 4:7]) / (2.0 * h)
        signed, far = f[:, 0].copy(), np.any(beyond != 0.0, axis=-1)
        unit = slope[far] / np.linalg.norm(slope[far], axis=-1, keepdims=True)
        away = beyond[far] + signed[far, None] * unit
        signed[far] = np.linalg.norm(away, axis=-1)
        slope[far] = away / signed[far, None]
        return signed, slope

    def curvature(self, point: Array) -> Array:
        """Hessians (M, 3, 3) of the distance at points (M, 3), 1/m; zero outside the lattice."""
        inner, beyond, h = self._inner(point)
        across = [[1, 1, 0], [-1, -1, 0], [1, 0, 1], [-1, 0, -1], [0, 1, 1], [0, -1, -1]]
        f = self._around(inner, h * np.array([[0, 0, 0], *np.eye(3), *-np.eye(3), *across]))
        own = (f[:, 1:4] + f[:, 4:7] - 2.0 * f[:, :1]) / h**2
        curved = np.zeros((len(point), 3, 3))
        curved[:, range(3), range(3)] = own
        for pair, (i, j) in zip(range(7, 13, 2), ((0, 1), (0, 2), (1, 2)), strict=True):
            both = (f[:, pair] + f[:, pair + 1] - 2.0 * f[:, 0]) / h**2
            curved[:, i, j] = curved[:, j, i] = 0.5 * (both - own[:, i] - own[:, j])
        curved[np.any(beyond != 0.0, axis=-1)] = 0.0
        return curved

    def _inner(self, point: Array) -> tuple[Array, Array, float]:
        """Nearest points (M, 3) inside the lattice, offsets (M, 3) from them, and difference step.

        All are in m; the step is that of the finite differences.
        """
        top = self.low + self.step * (np.array(self.values.shape) - 3.0)
        inner = np.clip(point, self.low + 2.0 * self.step, top)
        return inner, point - inner, 0.25 * self.step

    def _around(self, point: Array, offsets: Array) -> Array:
        """Values (M, F) of the spline at points (M, 3) plus each of the offsets (F, 3)."""
        at = ((point[:, None] + offsets - self.low) / self.step).reshape(-1, 3).T
        f = map_coordinates(self._spline, at, order=3, prefilter=False, mode="nearest")
        return np.asarray(f.reshape(len(point), len(offsets)))

    def surface(self) -> Surface:
        """The triangles from which the distances were computed."""
        return self.vertices, self.triangles


def read_mesh(path: Path, pose: Array, scale: float = 1.0) -> Mesh:
    """Read a closed surface from a file: STL, OBJ or PLY. Files that it refers to are not read.

    Args:
        path: The file.
        pose: Pose (4, 4) of the file's frame in the world.
        scale: Length of a unit of the file, m.

    Raises:
        GlissandoError: The file cannot be read, or has too many triangles; the surface is open, has
            inconsistent orientation, or is longer than 10 m; trimesh is not installed.
    """
    surface = _closed_surface(path, pose, scale)
    low, high = surface.bounds
    size = float(np.max(high - low))
    low, sides = low - _MARGIN * size, high - low + 2.0 * _MARGIN * size
    fine = min(size / _CELLS, float(np.min(high - surface.bounds[0])) / _THIN)
    step = max(fine, float(np.prod(sides) / _POINTS) ** (1.0 / 3.0))
    lattice = np.indices(np.ceil(sides / step).astype(int) + 1)
    points = low + step * np.moveaxis(lattice, 0, -1)
    solids = _solids(surface)
    signed = _signed(solids, points.reshape(-1, 3)).reshape(points.shape[:3])
    faces = np.asarray(surface.faces, dtype=np.intp)
    mesh = Mesh(low, step, signed, np.asarray(surface.vertices), faces)
    return replace(mesh, values=signed - _largest_overestimate(mesh, solids))


def _closed_surface(path: Path, pose: Array, scale: float) -> Any:
    """Closed, consistently oriented trimesh surface of a file, in the world; see `read_mesh`."""
    with needing("Meshes need trimesh and rtree", "mesh"):
        import rtree  # noqa: F401  which trimesh needs for distances
        import trimesh
    kind = path.suffix.lower().removeprefix(".")
    try:
        require_plain(path, _LARGEST)
        if kind not in _KINDS:
            raise ValueError(f"its name ends in {path.suffix[:20]!r}")
        with path.open("rb") as file:
            surface: Any = trimesh.load_mesh(file, file_type=kind, skip_materials=True)
        surface.apply_transform(pose @ np.diag([scale, scale, scale, 1.0]))
        sound = surface.faces.size and np.all(np.isfinite(surface.vertices))
    except Exception as problem:  # trimesh has no errors of its own
        why = str(problem)[:200] or type(problem).__name__
        raise GlissandoError(f"{path} is not a mesh ({why}); give STL, OBJ or PLY.") from None
    if not sound or len(surface.faces) > _TRIANGLES:
        raise GlissandoError(
            f"{path.name} has {len(surface.faces):,} triangles, or points that are not finite; "
            f"give 1 to {_TRIANGLES:,}."
        )
    if not surface.is_watertight:
        raise GlissandoError(
            f"{path.name} has holes, so it has no inside; close its surface, or give boxes."
        )
    if not surface.is_winding_consistent:
        raise GlissandoError(
            f"Some triangles of {path.name} face inwards and others outwards, so it has no inside; "
            f"repair it (unify its normals), or give boxes."
        )
    size = float(np.max(np.ptp(surface.bounds, axis=0)))
    if size > 10.0:
        raise GlissandoError(
            f"{path.name} is {size:.3g} m long; give scale = 0.001 if it is in millimetres."
        )
    return surface


Solid = tuple[Any, list[Any]]
"""A solid trimesh body and its cavities, all with triangles that face outwards."""


def _solids(surface: Any) -> list[Solid]:
    """Solid bodies of a closed surface, each with its cavities.

    A body whose triangles face inwards is a cavity of the bodies around it, and a solid if there
    are none. If the whole surface is inside out, all orientations are reversed first.
    """
    turn = 1.0 if surface.volume > 0.0 else -1.0
    bodies = surface.split()
    full = [_outwards(body) for body in bodies if turn * body.volume > 0.0]
    hollow = [_outwards(body) for body in bodies if turn * body.volume < 0.0]
    within = [[_distance(body, c.vertices[:1])[0] < 0.0 for body in full] for c in hollow]
    full += [c for c, inside in zip(hollow, within, strict=True) if not any(inside)]
    cavities = [[c for c, inside in zip(hollow, within, strict=True) if any(inside[k : k + 1])]
                for k in range(len(full))]  # fmt: skip
    return _joined(list(zip(full, cavities, strict=True)))


def _joined(solids: list[Solid]) -> list[Solid]:
    """Solids with those disjoint from all others merged into one mesh, for fewer queries."""
    import trimesh

    low, high = np.moveaxis(np.array([body.bounds for body, _ in solids]), 1, 0)
    overlaps = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=-1).sum(axis=1) > 1
    isolated = [
        not cavities and not meets for (_, cavities), meets in zip(solids, overlaps, strict=True)
    ]
    merged = [body for (body, _), one in zip(solids, isolated, strict=True) if one]
    others = [solid for solid, one in zip(solids, isolated, strict=True) if not one]
    return others + ([(trimesh.util.concatenate(merged), [])] if merged else [])


def _outwards(body: Any) -> Any:
    """The body with triangles that face outwards."""
    import trimesh

    return body if body.volume > 0.0 else trimesh.Trimesh(body.vertices, body.faces[:, ::-1])


def _signed(solids: Sequence[Solid], point: Array) -> Array:
    """Signed distances of points (M, 3) from solids, negative inside any of them."""
    out = np.full(len(point), np.inf)
    for body, cavities in solids:
        own = _distance(body, point)
        for cavity in cavities:
            own = np.maximum(own, -_distance(cavity, point))
        out = np.minimum(out, own)
    return out


def _distance(body: Any, point: Array) -> Array:
    """Signed distances of points (M, 3) from a trimesh body, negative inside.

    Points are processed in batches, since trimesh stores all triangles near each of them.
    """
    import trimesh

    inside_out: Any = trimesh.proximity.signed_distance
    parts = np.array_split(point, 1 + len(point) // _AT_ONCE)
    return -np.concatenate([np.asarray(inside_out(body, part)) for part in parts])


def _largest_overestimate(mesh: Mesh, solids: Sequence[Solid]) -> float:
    """Largest overestimate of distances near the surface, m, from random points there."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=-1)
    picked = rng.choice(len(area), _CHECKED, p=area / area.sum())
    within = rng.dirichlet(np.ones(3), _CHECKED)
    point = np.einsum("mi,mij->mj", within, corners[picked])
    point += mesh.step * rng.uniform(-1.0, 1.0, (_CHECKED, 3))
    over = mesh.distance(point)[0] - _signed(solids, point)
    return _SAFELY * max(0.0, float(over.max()))
