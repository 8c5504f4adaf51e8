"""The static shape of a loaded rod: equilibrium at Gauss points, solved by Newton's method.

The rod with its tendons is one body on which only the outside acts, so the force N and moment M it
carries at s follow from the loads beyond s. What the rod's own material carries is that less the
pull of the tendons, and linear elasticity turns it into strain:

    K (ε − ε_rest) + Σ τ [t; r × t] = [Rᵀ N; Rᵀ M],   t = (ν + u × r + r′)/|…|,
    N(s) = Σ forces beyond s,   M(s) = Σ moments beyond s + ∫ₛᴸ p′ × N dσ.

This is Rucker and Webster 2011 with the tendons' distributed and end loads integrated once: what
passes between tendon and disks is inside the body, friction too, and needs no term of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from glissando._kernels.threads import one_thread
from glissando.errors import NoShapeError
from glissando.geometry.se3 import Array, hat3
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Loads, Rod, Tendon, require_possible
from glissando.simulation.shape import Shape

_CLOSE = 1e-10  # residual in strain at which a shape is found
_SMOOTH = 3e-8  # rad that what an element cannot resolve may turn the rod by
_ITERATIONS = 25
_SMALLEST_STEP = 1e-4  # of the load, when it has to be put on bit by bit
_LONGEST = 4.0  # rad a step may turn the rod by: a longer one may land on another branch
_FINEST = 64  # elements the length may be divided into


def solve_shape(
    rod: Rod, tendons: Sequence[Tendon], loads: Loads, *, start: Shape | None = None
) -> Shape:
    """The stable static shape that the unloaded rod takes when the loads are put on.

    Elements are halved until strain is resolved, or a 64th of the length long where the rest strain
    itself jumps.

    Args:
        rod: The rod.
        tendons: Its tendons.
        loads: What acts on it.
        start: A shape under similar loads, which saves iterations.

    Raises:
        SimulationError: Tendons or loads are impossible.
        NoShapeError: The rod buckles on the way, or no shape is found.
    """
    require_possible(rod, tendons, loads)
    breaks = [0.0, rod.length, *(t.end for t in tendons), *(w.arclength for w in loads.wrenches)]
    largest = rod.length / 2.0
    if start is not None and start.mesh.has(breaks):
        mesh, guess = start.mesh, start.strain
    else:
        mesh, guess = Mesh.through(breaks, largest), None
    with one_thread():
        while True:
            problem = _Problem.of(rod, tendons, loads, mesh)
            strain = problem.load_up(guess)
            smooth = mesh.unresolved(strain) < _SMOOTH
            if smooth or np.diff(mesh.edges).max() < rod.length / _FINEST:
                return problem.shape(strain)
            finer = Mesh.through(mesh.edges, 0.5 * np.diff(mesh.edges).max())
            mesh, guess = finer, resample(mesh, strain, finer)


def resample(mesh: Mesh, strain: Array, other: Mesh) -> Array:
    """Strain (G', 6) at the points of another mesh of the same rod."""
    each = np.broadcast_to(strain, (other.points.size, *strain.shape))
    return mesh.interpolate(each, other.points)


@dataclass(frozen=True)
class _At:
    """A trial strain (G, 6), its residual, and what the residual's derivative is made of."""

    strain: Array
    residual: Array
    turn: Array
    along: Array
    force: Array
    moment: Array
    tendon_slope: Array


def _each(left: Array, right: Array) -> Array:
    """Product (G, 3, H, 3) of matrices (G, 3, 3) with blocks (G, 3, H, 3)."""
    return (left @ right.reshape(len(left), 3, -1)).reshape(right.shape)


@dataclass(frozen=True)
class _Problem:
    """Loads on a mesh: everything that does not depend on the shape."""

    rod: Rod
    mesh: Mesh
    rest: Array  # (G, 6)
    force: Array  # (G, 3) N, world
    moment: Array  # (G, 3) of moments beyond s, world
    pull: Array  # (T, G) tension of each tendon at each point but for friction, zero beyond its end
    friction: Array  # (T, 1)
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
        tensions = np.reshape(loads.tensions, (-1, 1))
        pull = tensions * (s < np.reshape([tendon.end for tendon in tendons], (-1, 1)))
        friction = np.reshape([tendon.friction for tendon in tendons], (-1, 1))
        paths = np.reshape([tendon.path(s) for tendon in tendons], (-1, 2, s.size, 3))
        load = (rod.rest(s), force, moment, pull, friction, paths[:, 0], paths[:, 1])
        return _Problem(rod, mesh, *load, mesh.integral, mesh.weights - mesh.integral)

    def load_up(self, guess: Array | None) -> Array:
        """Strain (G, 6) under the whole load, which is put on bit by bit if it must be."""
        warm = None if guess is None else self._newton(guess, 1.0)
        if warm is not None:
            return warm
        strain, share, step = np.array(self.rest), 0.0, 1.0
        while share < 1.0:
            step = min(step, 1.0 - share)
            loaded = self._newton(strain, share + step)
            if loaded is None:
                step *= 0.5
                if step < _SMALLEST_STEP:
                    percent = f"{100 * share:.1f}" if share > 1e-3 else f"{100 * share:.2g}"
                    raise NoShapeError(
                        f"Under {percent} % of these loads the rod buckles, or no static "
                        f"shape continues the unloaded one; reduce tensions or forces below that."
                    )
                continue
            strain, share, step = loaded, share + step, 2.0 * step
        return strain

    def _newton(self, strain: Array, share: float) -> Array | None:
        """A stable equilibrium near `strain` under a share of the loads, or None.

        A derivative is kept for as long as each step with it makes the residual five times smaller.
        """
        here = self._at(strain, share)
        size, slope = np.abs(here.residual).max(), None
        for _ in range(_ITERATIONS):
            if size < _CLOSE * (1.0 + np.abs(strain).max()):
                return strain if self._is_stable(self._jacobian(here)) else None
            fresh = slope is None
            if slope is None:
                slope = lu_factor(self._jacobian(here), check_finite=False)
            step = lu_solve(slope, here.residual.ravel(), check_finite=False)
            if not np.abs(step).max() * self.rod.length < _LONGEST:
                return None
            there, found = self._shorten(strain, step.reshape(strain.shape), share, size)
            if not found < (2.0 * size if fresh else size):
                if fresh:
                    return None
                slope = None
                continue
            strain, here = there.strain, there
            slope = slope if found < 0.2 * size else None
            size = found
        return None

    def _shorten(self, strain: Array, step: Array, share: float, size: float) -> tuple[_At, float]:
        """Where a step leads, halved up to three times if the residual would grow."""
        shorter = 1.0
        while True:
            there = self._at(strain - shorter * step, share)
            found = float(np.abs(there.residual).max())
            if found < size or shorter < 0.2:
                return there, found
            shorter *= 0.5

    def _at(self, strain: Array, share: float) -> _At:
        """Residual at a strain, and what its derivative is made of."""
        turn = self.mesh.roll_out(strain, self.rod.base)[0][:, :3, :3]
        force = share * self.force
        along = np.einsum("gij,gj->gi", turn, strain[:, :3])  # p′
        moment = share * self.moment + self.beyond @ np.cross(along, force)
        carried = np.einsum("gji,cgj->cgi", turn, np.stack([force, moment]))
        tendon, tendon_slope = self._tendons(strain, share)
        carried = np.concatenate([*carried], axis=-1)
        residual = strain - self.rest + (tendon - carried) / self.rod.stiffness
        return _At(strain, residual, turn, along, force, moment, tendon_slope)

    def _jacobian(self, at: _At) -> Array:
        """Derivative (6G, 6G) of the residual by strain."""
        turn, back = at.turn, np.swapaxes(at.turn, -1, -2)
        points = self.mesh.points.size
        # a rotation δθ(σ) = ∫₀^σ R δu turns p′, and with it the moment of everything beyond
        turned = self.before[:, None, :, None] * np.swapaxes(turn, 0, 1)[None]  # (G, 3, G, 3)
        levered = _each(hat3(at.force) @ hat3(at.along), turned).reshape(points, -1)
        by_turn = (self.beyond @ levered).reshape(turned.shape)
        by_stretch = self.beyond[:, None, :, None] * np.swapaxes(-hat3(at.force) @ turn, 0, 1)[None]
        jacobian = np.zeros((points, 6, points, 6))
        jacobian[:, :3, :, 3:] = _each(-back @ hat3(at.force), turned)
        jacobian[:, 3:, :, :3] = _each(-back, by_stretch)
        jacobian[:, 3:, :, 3:] = _each(-back @ hat3(at.moment), turned) - _each(back, by_turn)
        g = np.arange(points)
        jacobian[g, :, g] += at.tendon_slope
        jacobian /= self.rod.stiffness[None, :, None, None]
        jacobian[g, :, g] += np.eye(6)
        return jacobian.reshape(6 * points, 6 * points)

    def _tendons(self, strain: Array, share: float) -> tuple[Array, Array]:
        """Wrench (G, 6) of all tendons on the section and its derivative (G, 6, 6) by strain.

        The derivative leaves friction out: Newton's method then gains a digit or so an iteration.
        """
        arm = hat3(self.place)
        along = strain[:, :3] + np.cross(strain[:, 3:], self.place) + self.slope  # (T, G, 3)
        length = np.linalg.norm(along, axis=-1, keepdims=True)
        unit = along / length
        bend = np.linalg.norm(np.cross(strain[:, 3:], unit), axis=-1) @ self.before.T
        pull = (share * self.pull * np.exp(-self.friction * bend))[..., None]
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
