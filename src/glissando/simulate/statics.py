"""The static shape of a loaded rod: equilibrium at Gauss points, solved by Newton's method.

The rod with its tendons is one body on which only the outside acts, so the force N and moment M it
carries at s follow from the loads beyond s. What the rod's own material carries is that less the
pull of the tendons, and linear elasticity turns it into strain:

    K (ε − ε_rest) + Σ τ [t; r × t] = [Rᵀ N; Rᵀ M],   t = (ν + u × r + r′)/|…|,
    N(s) = Σ forces beyond s,   M(s) = Σ moments beyond s + ∫ₛᴸ p′ × N dσ.

This is Rucker and Webster 2011 with the tendons' distributed and end loads integrated once; a
frictionless tendon's reactions are inside the section and need no term of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.se3 import Array, hat3
from glissando.simulate.mesh import Mesh
from glissando.simulate.rod import Loads, NoShapeError, Rod, Tendon, require_possible
from glissando.simulate.shape import Shape

_CLOSE = 1e-10  # residual in strain at which a shape is found
_SMOOTH = 1e-8  # share of the highest modes in strain above which elements are halved
_ITERATIONS = 25
_SMALLEST_STEP = 1e-3  # of the load, when it has to be put on bit by bit
_FINEST = 64  # elements the length may be divided into


def solve_shape(
    rod: Rod, tendons: Sequence[Tendon], loads: Loads, *, start: Shape | None = None
) -> Shape:
    """The stable static shape that the unloaded rod takes when the loads are put on.

    `start`, a shape under similar loads, saves iterations. Elements are halved until strain is
    resolved. Raises SimulationError for impossible tendons or loads, NoShapeError when the rod
    buckles on the way or no shape is found.
    """
    require_possible(rod, tendons, loads)
    breaks = [0.0, rod.length, *(t.end for t in tendons), *(w.arclength for w in loads.wrenches)]
    largest = rod.length / 2.0
    if start is not None and set(np.round(breaks, 12)) <= set(np.round(start.mesh.edges, 12)):
        mesh, guess = start.mesh, start.strain
    else:
        mesh, guess = Mesh.through(breaks, largest), None
    while True:
        problem = _Problem.of(rod, tendons, loads, mesh)
        strain = problem.load_up(guess)
        smooth = mesh.roughness(strain) < _SMOOTH
        if smooth or np.diff(mesh.edges).max() < rod.length / _FINEST:
            return problem.shape(strain)
        finer = Mesh.through(mesh.edges, 0.5 * np.diff(mesh.edges).max())
        mesh, guess = finer, resample(mesh, strain, finer)


def resample(mesh: Mesh, strain: Array, other: Mesh) -> Array:
    """Strain (G', 6) at the points of another mesh of the same rod."""
    each = np.broadcast_to(strain, (other.points.size, *strain.shape))
    return mesh.interpolate(each, other.points)


@dataclass(frozen=True)
class _Problem:
    """Loads on a mesh: everything that does not depend on the shape."""

    rod: Rod
    tendons: Sequence[Tendon]
    loads: Loads
    mesh: Mesh
    rest: Array  # (G, 6)
    force: Array  # (G, 3) N, world
    moment: Array  # (G, 3) of moments beyond s, world
    pull: Array  # (T, G) tension of each tendon at each point, zero beyond its end
    place: Array  # (T, G, 3)
    slope: Array  # (T, G, 3)
    before: Array  # (G, G) integral from 0
    beyond: Array  # (G, G) integral to L

    @staticmethod
    def of(rod: Rod, tendons: Sequence[Tendon], loads: Loads, mesh: Mesh) -> _Problem:
        s = mesh.points
        weight = rod.mass_per_length * np.asarray(loads.gravity, dtype=float)
        force = (rod.length - s)[:, None] * weight
        moment = np.zeros((s.size, 3))
        for wrench in loads.wrenches:
            force += (s < wrench.arclength)[:, None] * np.asarray(wrench.force)
            moment += (s < wrench.arclength)[:, None] * np.asarray(wrench.moment)
        pull = np.array(
            [
                t * (s < tendon.end)
                for t, tendon in zip(np.ravel(loads.tensions), tendons, strict=True)
            ]
        ).reshape(len(tendons), s.size)
        paths = [tendon.path(s) for tendon in tendons]
        place, slope = (
            np.array([path[i] for path in paths]).reshape(len(tendons), s.size, 3) for i in (0, 1)
        )
        before = mesh.integral
        beyond = mesh.weights - before
        rest = rod.rest(s)
        return _Problem(
            rod, tendons, loads, mesh, rest, force, moment, pull, place, slope, before, beyond
        )

    def load_up(self, guess: Array | None) -> Array:
        """Strain (G, 6) under the whole load, which is put on bit by bit if it must be."""
        if guess is not None:
            found = self._newton(guess, 1.0)
            if found is not None:
                return found
        strain, share, step = np.array(self.rest), 0.0, 1.0
        while share < 1.0:
            step = min(step, 1.0 - share)
            found = self._newton(strain, share + step)
            if found is None:
                step *= 0.5
                if step < _SMALLEST_STEP:
                    raise NoShapeError(
                        f"Under {100 * share:.1f} % of these loads the rod buckles, or no static "
                        f"shape continues the unloaded one; reduce tensions or forces below that."
                    )
                continue
            strain, share, step = found, share + step, 2.0 * step
        return strain

    def _newton(self, strain: Array, share: float) -> Array | None:
        """A stable equilibrium near `strain` under a share of the loads, or None."""
        residual, jacobian = self._linearize(strain, share)
        size = np.abs(residual).max()
        for _ in range(_ITERATIONS):
            if size < _CLOSE * (1.0 + np.abs(strain).max()):
                return strain if self._is_stable(jacobian) else None
            step = np.linalg.solve(jacobian, residual.ravel()).reshape(strain.shape)
            if not np.abs(step).max() * self.rod.length < 20.0:
                return None
            shorter = 1.0
            while True:
                there = strain - shorter * step
                residual, jacobian_there = self._linearize(there, share)
                found = np.abs(residual).max()
                if found < size or shorter < 0.1:
                    break
                shorter *= 0.5
            if not found < 2.0 * size:
                return None
            strain, size, jacobian = there, found, jacobian_there
        return None

    def _linearize(self, strain: Array, share: float) -> tuple[Array, Array]:
        """Residual (G, 6) in strain and its derivative (6G, 6G)."""
        stiffness, points = self.rod.stiffness, self.mesh.points.size
        pose = self.mesh.roll_out(strain, self.rod.base)[0]
        turn, back = pose[:, :3, :3], np.swapaxes(pose[:, :3, :3], -1, -2)
        force = share * self.force
        along = np.einsum("gij,gj->gi", turn, strain[:, :3])  # p′
        moment = share * self.moment + self.beyond @ np.cross(along, force)
        carried = np.concatenate(
            [np.einsum("gij,gj->gi", back, force), np.einsum("gij,gj->gi", back, moment)], axis=-1
        )
        tendon, tendon_slope = self._tendons(strain, share)
        residual = strain - self.rest + (tendon - carried) / stiffness

        # a rotation δθ(σ) = ∫₀^σ R δu turns p′, and with it the moment of everything beyond
        turned = self.before[:, None, :, None] * np.swapaxes(turn, 0, 1)[None]  # (G, 3, G, 3)
        lever = hat3(force) @ hat3(along)
        by_turn = np.einsum("gij,gjhk->gihk", lever, turned)
        by_turn = (self.beyond @ by_turn.reshape(points, -1)).reshape(turned.shape)
        by_stretch = self.beyond[:, None, :, None] * np.swapaxes(-hat3(force) @ turn, 0, 1)[None]
        jacobian = np.zeros((points, 6, points, 6))
        jacobian[:, :3, :, 3:] = np.einsum("gij,gjhk->gihk", -back @ hat3(force), turned)
        jacobian[:, 3:, :, :3] = np.einsum("gij,gjhk->gihk", -back, by_stretch)
        jacobian[:, 3:, :, 3:] = np.einsum("gij,gjhk->gihk", -back @ hat3(moment), turned)
        jacobian[:, 3:, :, 3:] -= np.einsum("gij,gjhk->gihk", back, by_turn)
        g = np.arange(points)
        jacobian[g, :, g] += tendon_slope
        jacobian /= stiffness[None, :, None, None]
        jacobian[g, :, g] += np.eye(6)
        return residual, jacobian.reshape(6 * points, 6 * points)

    def _tendons(self, strain: Array, share: float) -> tuple[Array, Array]:
        """Wrench (G, 6) of all tendons on the section and its derivative (G, 6, 6) by strain."""
        arm = hat3(self.place)
        along = strain[:, :3] + np.cross(strain[:, 3:], self.place) + self.slope  # (T, G, 3)
        length = np.linalg.norm(along, axis=-1, keepdims=True)
        unit = along / length
        pull = share * self.pull[..., None]
        reach = np.concatenate([np.broadcast_to(np.eye(3), arm.shape), -arm], axis=-1)  # ∂along/∂ε
        across = np.eye(3) - unit[..., :, None] * unit[..., None, :]
        back = np.swapaxes(reach, -1, -2)
        wrench = np.einsum("tgij,tgj->gi", back, pull * unit)
        return wrench, np.sum(back @ ((pull / length)[..., None] * across) @ reach, axis=0)

    def _is_stable(self, jacobian: Array) -> bool:
        """Whether the potential energy has a minimum here: its Hessian is positive definite."""
        scale = np.sqrt(self.mesh.weights[:, None] * self.rod.stiffness).ravel()
        hessian = scale[:, None] * jacobian / scale
        try:
            np.linalg.cholesky(0.5 * (hessian + hessian.T))
        except np.linalg.LinAlgError:
            return False
        return True

    def shape(self, strain: Array) -> Shape:
        """The shape, with what its material carries."""
        edges = self.mesh.roll_out(strain, self.rod.base)[1]
        return Shape(self.rod, self.mesh, strain, edges)
