"""Static shape of a loaded rod: equilibrium at Gauss points, solved by Newton's method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from glissando._kernels.threads import one_thread
from glissando.errors import NoShapeError
from glissando.geometry.se3 import Array
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Loads, Rod, Tendon, Wrench, require_possible
from glissando.simulation.rod_equations import AppliedLoads, Balance, RodEquations
from glissando.simulation.rod_mechanics import matrices
from glissando.simulation.shape import Shape

_CLOSE = 1e-10  # residual in strain at which the iteration has converged
_SMOOTH = 3e-8  # rad: largest rotation by unresolved modes of strain
_ITERATIONS = 25
_SMALLEST_STEP = 1e-4  # of the load, in load stepping
_LONGEST = 4.0  # rad: largest rotation of a step, as longer ones may reach another branch
_FINEST = 64  # refinement ends at elements of this fraction of the length


def solve_shape(
    rod: Rod,
    tendons: Sequence[Tendon],
    loads: Loads,
    *,
    start: Shape | None = None,
    stable: bool = True,
) -> Shape:
    """Static shape of a rod under loads, near `start` or continued from the unloaded shape.

    Elements are halved until strain is resolved, or, where the rest strain itself jumps, until they
    are shorter than 1/64 of the length.

    Args:
        rod: The rod.
        tendons: Tendons of the rod.
        loads: External loads.
        start: Shape under similar loads, as an initial guess.
        stable: Whether the shape must be a stable equilibrium; if False, unstable equilibria are
            accepted too, as by solvers without a stability test.

    Raises:
        SimulationError: Tendons or loads are impossible.
        NoShapeError: The rod buckles during loading, or the iteration does not converge.
    """
    require_possible(rod, tendons, loads)
    breaks = [0.0, rod.length, *(t.end for t in tendons), *(w.arclength for w in loads.wrenches)]

    def equilibrium_on(mesh: Mesh) -> Equilibrium:
        return replace(Equilibrium.of(rod, tendons, loads, mesh), stable=stable)

    return settle(equilibrium_on, rod, breaks, start=start)


def settle(
    equilibrium: Callable[[Mesh], Equilibrium],
    rod: Rod,
    breaks: Sequence[float],
    mesh: Mesh | None = None,
    *,
    start: Shape | None = None,
) -> Shape:
    """Solve an equilibrium on a mesh that is refined until strain is resolved.

    Args:
        equilibrium: Function of a mesh that returns the equilibrium on it.
        rod: The rod.
        breaks: Arclengths at which the mesh needs edges, m.
        mesh: Mesh to use without refinement, or None.
        start: Shape under similar loads, as an initial guess.

    Raises:
        NoShapeError: The rod buckles during loading, or the iteration does not converge.
    """
    largest, guess, fixed = rod.length / 2.0, None, mesh is not None
    if mesh is None and start is not None and start.mesh.has(breaks):
        mesh, guess = start.mesh, start.strain
    mesh = mesh or Mesh.through(breaks, largest)
    with one_thread():
        while True:
            problem = equilibrium(mesh)
            strain = problem.loaded_strain(guess)
            smooth = fixed or mesh.unresolved(strain) < _SMOOTH
            if smooth or np.diff(mesh.edges).max() < rod.length / _FINEST:
                return problem.shape(strain)
            finer = Mesh.through(mesh.edges, 0.5 * np.diff(mesh.edges).max())
            mesh, guess = finer, resample(mesh, strain, finer)


def resample(mesh: Mesh, strain: Array, other: Mesh) -> Array:
    """Interpolate strain (G, 6) to the points of another mesh of the same rod: (G', 6)."""
    each = np.broadcast_to(strain, (other.points.size, *strain.shape))
    return mesh.interpolate(each, other.points)


@dataclass(frozen=True)
class Equilibrium:
    """Equilibrium of a rod on a mesh under constant loads.

    Attributes:
        equations: Equations of the rod with its tendons on a mesh.
        instant: Loads on the rod.
        stable: Whether unstable equilibria are rejected.
    """

    equations: RodEquations
    instant: AppliedLoads
    stable: bool = True

    @staticmethod
    def of(rod: Rod, tendons: Sequence[Tendon], loads: Loads, mesh: Mesh) -> Equilibrium:
        """Equilibrium of a rod on a mesh that has an edge at every tendon's end and load."""
        cables = np.zeros((len(tendons), 4))
        cables[:, 0], cables[:, 3] = loads.tensions, [tendon.friction for tendon in tendons]
        sites = beyond_base([site(mesh, wrench) for wrench in loads.wrenches])
        gravity = np.asarray(loads.gravity, dtype=float)
        instant = AppliedLoads(rod.base, gravity, cables, sites)
        return Equilibrium(RodEquations.of(rod, tendons, mesh), instant)

    def loaded_strain(self, guess: Array | None) -> Array:
        """Strain (G, 6) under the full load, from the guess or by stepping the load from zero."""
        from_guess = None if guess is None else self._newton(guess, 1.0)
        if from_guess is not None:
            return from_guess
        strain, share, step = np.array(self.equations.rest), 0.0, 1.0
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
        """Equilibrium strain near `strain` under a share of the loads, or None if not found.

        None also if the equilibrium is unstable and `stable` is set. The factored Jacobian is
        reused while each step reduces the residual by a factor of five.
        """
        balance = self._balance(strain, share)
        size, jacobian = self._residual_norm(balance), None
        for _ in range(_ITERATIONS):
            if size < _CLOSE * (1.0 + np.abs(strain).max()):
                accepted = not self.stable or self._is_stable(self._jacobian(balance, share))
                return strain if accepted else None
            fresh = jacobian is None
            if jacobian is None:
                jacobian = lu_factor(self._jacobian(balance, share), check_finite=False)
            work = self.equations.mesh.weights[:, None] * balance.residual
            step = lu_solve(jacobian, work.ravel(), check_finite=False)
            if not np.abs(step).max() * self.equations.rod.length < _LONGEST:
                return None
            trial, trial_balance, trial_size = self._line_search(
                strain, step.reshape(strain.shape), share, size
            )
            if not trial_size < (2.0 * size if fresh else size):
                if fresh:
                    return None
                jacobian = None
                continue
            strain, balance = trial, trial_balance
            jacobian = jacobian if trial_size < 0.2 * size else None
            size = trial_size
        return None

    def _line_search(
        self, strain: Array, step: Array, share: float, size: float
    ) -> tuple[Array, Balance, float]:
        """Strain, balance and residual after a step, halved up to three times if it increases."""
        shorter = 1.0
        while True:
            trial = strain - shorter * step
            balance = self._balance(trial, share)
            trial_size = self._residual_norm(balance)
            if trial_size < size or shorter < 0.2:
                return trial, balance, trial_size
            shorter *= 0.5

    def _balance(self, strain: Array, share: float) -> Balance:
        """Static balance of a strain under a share of the loads."""
        state = np.stack([strain, np.zeros_like(strain), np.zeros_like(strain)])
        return self.equations.at(state, self.instant.share(share))

    def _residual_norm(self, balance: Balance) -> float:
        """Largest residual in units of strain, as residual over stiffness."""
        return float(np.abs(balance.residual / self.equations.rod.stiffness).max())

    def _jacobian(self, balance: Balance, share: float) -> Array:
        """Jacobian (6G, 6G) of the residual with respect to strain, rows times Gauss weights."""
        instant = self.instant.share(share)
        if instant.planes.size or np.any(instant.sites[:, 10]):
            return matrices(self.equations, balance, instant).stiffness
        return self.equations.stiffness(balance, instant.cables)

    def _is_stable(self, jacobian: Array) -> bool:
        """Whether the potential energy is at a minimum: its Hessian is positive definite."""
        mesh, rod = self.equations.mesh, self.equations.rod
        scale = 1.0 / np.sqrt(mesh.weights[:, None] * rod.stiffness).ravel()
        hessian = scale[:, None] * jacobian * scale
        try:
            np.linalg.cholesky(0.5 * (hessian + hessian.T))
        except np.linalg.LinAlgError:
            return False
        return True

    def shape(self, strain: Array) -> Shape:
        """Shape with this strain (G, 6)."""
        rod, mesh = self.equations.rod, self.equations.mesh
        return Shape(rod, mesh, strain, mesh.roll_out(strain, rod.base)[1])


def site(mesh: Mesh, wrench: Wrench) -> Array:
    """Row (12,) of `AppliedLoads.sites` for a dead load at an edge of a mesh."""
    row = np.zeros(12)
    row[0] = np.abs(mesh.edges - wrench.arclength).argmin() - 1
    row[1:4], row[4:7] = wrench.force, wrench.moment
    return row


def beyond_base(rows: Sequence[Array]) -> Array:
    """Rows (E, 12) of loads that act beyond the base; loads at the base do not load the rod."""
    sites = np.reshape(rows, (-1, 12))
    return sites[sites[:, 0] >= 0.0]
