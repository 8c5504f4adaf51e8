"""Balance of force and moment of a rod with tendons at the Gauss points of a mesh.

Rod and tendons form one body under external loads only, so the internal force N and moment M at s
are the resultants of the loads beyond s, inertia included. The rod's material carries these less
the tendons' tension:

    K (ε − ε_rest) + D ∂ε/∂t + Σ τ [t; r × t] = [Rᵀ N; Rᵀ M],   t = (ν + u × r + r′)/|…|.

This is Rucker and Webster 2011 with the tendons' distributed and end loads integrated once: forces
between tendon and disks, friction included, are internal to the body and need no terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from glissando._kernels import rod_forces
from glissando.geometry.se3 import Array, hat3
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Rod, Tendon


@dataclass(frozen=True)
class AppliedLoads:
    """Loads on a rod and motion of its base at one time.

    Attributes:
        base: Pose of the base (4, 4).
        base_rates: Velocity, angular velocity and their time derivatives (4, 3), world axes.
        gravity: Gravity (3,), m/s².
        cables: Tension at natural length (N), stiffness (N/m), natural length (m) and friction of
            each tendon (T, 4); tension increases with length by the stiffness, and is never < 0.
        planes: Point, normal, stiffness (N/m²), damping (s/m) and friction of half-spaces (C, 9).
        sites: Index of the element at whose end the load acts, dead force and moment (world), and
            anchor, stiffness (N/m) and damping (N s/m) of a spring (H, 12).
    """

    base: Array
    gravity: Array
    cables: Array
    sites: Array = field(default_factory=lambda: np.zeros((0, 12)))
    planes: Array = field(default_factory=lambda: np.zeros((0, 9)))
    base_rates: Array = field(default_factory=lambda: np.zeros((4, 3)))

    def share(self, share: float) -> AppliedLoads:
        """Copy with all loads, and stiffnesses of tendons, contacts and springs, times `share`."""
        cables, planes, sites = np.array(self.cables), np.array(self.planes), np.array(self.sites)
        cables[:, :2] *= share
        planes[:, 6] *= share
        sites[:, 1:7] *= share
        sites[:, 10:] *= share
        return replace(
            self, gravity=share * self.gravity, cables=cables, planes=planes, sites=sites
        )


class Balance(NamedTuple):
    """Balance with its intermediate terms, in world axes; S places are G points and E element ends.

    Attributes:
        residual: Material and tendon wrench minus internal wrench of the loads (G, 6), body axes.
        turn, place, rates: Rotations (S, 3, 3), positions (S, 3), and velocity, angular velocity,
            acceleration, angular acceleration (4, S, 3) of the places.
        along: Tangents ∂p/∂s (G, 3).
        carried: Internal force and moment (2, G + 1, 3) at the points and, last, at the base.
        touch: Contact force per metre (1, G, 3).
        ends: Force and moment at the elements' ends (E, 6).
        pull, unit, stretch: Tension (T, G), tangent (T, G, 3) and stretch (T, G) of tendons.
    """

    residual: Array
    turn: Array
    place: Array
    rates: Array
    along: Array
    carried: Array
    touch: Array
    ends: Array
    pull: Array
    unit: Array
    stretch: Array


def _each(left: Array, right: Array) -> Array:
    """Product (G, 3, H, 3) of matrices (G, 3, 3) with blocks (G, 3, H, 3)."""
    return (left @ right.reshape(len(left), 3, -1)).reshape(right.shape)


@dataclass(frozen=True)
class RodEquations:
    """Constants of a rod with its tendons on a mesh, independent of time and shape."""

    rod: Rod
    tendons: tuple[Tendon, ...]
    mesh: Mesh
    rest: Array  # (G, 6)
    section: Array  # (3, 6) stiffness; damping; mass, rotary inertia (3), air damping
    paths: Array  # (T, 3, G, 3) positions, derivatives, and 1 up to the tendon's end, else 0
    before: Array  # (S, G) integral from 0
    beyond: Array  # (G + 1, G) integral to L

    @staticmethod
    def of(rod: Rod, tendons: Sequence[Tendon], mesh: Mesh) -> RodEquations:
        """Equations of a rod on a mesh that has an edge at every tendon's end."""
        s, element = mesh.points, np.arange(mesh.points.size) // mesh.steps.shape[2]
        section = np.zeros((3, 6))
        section[0], section[1] = rod.stiffness, rod.retardation * rod.stiffness
        section[2, :5] = [rod.mass_per_length, *rod.rotary_inertia, rod.air_damping]
        paths = np.zeros((len(tendons), 3, s.size, 3))
        for path, tendon in zip(paths, tendons, strict=True):
            path[:2], path[2] = tendon.path(s), (s < tendon.end)[:, None]
        to_ends = np.where(element <= np.arange(mesh.edges.size - 1)[:, None], mesh.weights, 0.0)
        inner = mesh.integral
        before = np.concatenate([inner, to_ends])
        beyond = np.concatenate([mesh.weights - inner, mesh.weights[None]])
        rest = np.array(rod.rest(s), dtype=float, order="C")
        return RodEquations(rod, tuple(tendons), mesh, rest, section, paths, before, beyond)

    @property
    def size(self) -> int:
        """Number of unknown strains."""
        return self.rest.size

    def at(self, state: Array, instant: AppliedLoads) -> Balance:
        """Balance for strains and their first and second time derivatives (3, G, 6)."""
        mesh, a = self.mesh, instant
        fixed = mesh.steps, mesh.widths, self.before, self.beyond, mesh.weights
        own = self.rest, self.section, self.paths
        acting = a.base, a.base_rates, a.gravity, a.cables, a.planes, a.sites
        return Balance(*rod_forces.balance(np.ascontiguousarray(state), *fixed, *own, *acting))

    def stiffness(self, at: Balance, cables: Array) -> Array:
        """Jacobian (6G, 6G) of the residual with respect to strain, rows times Gauss weights.

        Friction of tendons and, of inertia, all but mass times acceleration are neglected: Newton's
        method then gains about a digit per iteration.
        """
        points = len(self.rest)
        turn, before, beyond = at.turn[:points], self.before[:points], self.beyond[:points]
        back = np.swapaxes(turn, -1, -2)
        force, moment = hat3(at.carried[0, :points]), hat3(at.carried[1, :points])
        # a rotation δθ(σ) = ∫₀^σ R δu rotates p′, and so changes the moment of all loads beyond
        turned = before[:, None, :, None] * np.swapaxes(turn, 0, 1)[None]  # (G, 3, G, 3)
        levered = _each(force @ hat3(at.along), turned).reshape(points, -1)
        by_turn = (beyond @ levered).reshape(turned.shape)
        by_stretch = beyond[:, None, :, None] * np.swapaxes(-force @ turn, 0, 1)[None]
        slope = np.zeros((points, 6, points, 6))
        slope[:, :3, :, 3:] = _each(-back @ force, turned)
        slope[:, 3:, :, :3] = _each(-back, by_stretch)
        slope[:, 3:, :, 3:] = _each(-back @ moment, turned) - _each(back, by_turn)
        slope *= self.mesh.weights[:, None, None, None]
        self._add_tendons(slope, at, cables)
        g = np.arange(points)
        diagonal = self.mesh.weights[:, None] * self.section[0]
        slope[g, :, g] += diagonal[:, :, None] * np.eye(6)
        return slope.reshape(6 * points, 6 * points)

    def _add_tendons(self, slope: Array, at: Balance, cables: Array) -> None:
        """Add the tendons' stiffness: rotation of their tangents and, if elastic, their tension."""
        weights, covered = self.mesh.weights, self.paths[:, 2, :, 0]
        arm = hat3(self.paths[:, 0])
        reach = np.concatenate([np.broadcast_to(np.eye(3), arm.shape), -arm], axis=-1)  # ∂along/∂ε
        across = np.eye(3) - at.unit[..., :, None] * at.unit[..., None, :]
        back = np.swapaxes(reach, -1, -2)
        tight = (weights * at.pull / at.stretch)[..., None, None]
        g = np.arange(len(weights))
        slope[g, :, g] += np.sum(tight * (back @ across @ reach), axis=0)
        for j in np.flatnonzero((cables[:, 1] > 0.0) & (at.pull.max(axis=1, initial=0.0) > 0.0)):
            by_strain = (
                np.einsum("gij,gj->gi", back[j], at.unit[j]) * (weights * covered[j])[:, None]
            )
            friction = at.pull[j] / at.pull[j].max()
            pulled = cables[j, 1] * friction[:, None] * by_strain
            slope += pulled[:, :, None, None] * by_strain
