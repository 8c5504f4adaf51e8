"""Time integration of a rod's motion by implicit steps with error control.

A step collocates (see `collocation`) the balance M(q) a + D v + K(q) … = 0 of strains q, which are
integrated to poses from the base: strains are a vector space, so poses stay in the group.
Source: Hairer and Wanner 1996, section IV.8 (Newton iteration, error and step size).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from glissando._kernels.threads import one_thread
from glissando.errors import NoShapeError, SimulationError
from glissando.geometry.se3 import Array
from glissando.simulation.dynamics.collocation import METHODS, Collocation
from glissando.simulation.dynamics.motion import DynamicMotion, Moment
from glissando.simulation.dynamics.scenario import Scenario, ScenarioLoads
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Loads, Rod, Tendon, require_possible
from glissando.simulation.rod_equations import AppliedLoads, Balance, RodEquations
from glissando.simulation.rod_mechanics import Matrices, energies, matrices, powers
from glissando.simulation.statics import Equilibrium, settle

_NEWTON = 1e-3  # of the tolerance, to which a step's equations are solved
_ITERATIONS = 12
_FIRST = 1e-4  # s: first step after an event
_LONGEST = 0.05  # s
_SHORTEST = 1e-9  # s
_STEPS = 2_000_000


def simulate_motion(
    rod: Rod,
    tendons: Sequence[Tendon],
    scenario: Scenario,
    duration: float,
    *,
    tolerance: float = 1e-5,
    step: float | None = None,
    method: str = "radau",
    start: tuple[Array, Array] | None = None,
    mesh: Mesh | None = None,
) -> DynamicMotion:
    """Simulate the motion of a rod under a scenario, from rest or from a given state.

    Args:
        rod: The rod, with its mass and damping.
        tendons: Tendons of the rod.
        scenario: Tendons, loads, contacts and base over time.
        duration: Duration, s.
        tolerance: Position error per step, as a fraction of the rod's length.
        step: Constant step length, s; adaptive if None.
        method: 'radau', of order 5, which damps modes that a step does not resolve, or 'gauss', of
            order 6, which conserves the energy of an undamped rod and needs a `step`.
        start: Strain and strain rate, both (G, 6), at the points of `mesh`; by default at rest in
            the static shape under the initial loads.
        mesh: Mesh with an edge wherever a load acts; by default that of the static shape.

    Raises:
        SimulationError: An argument is impossible.
        NoShapeError: The rod has no initial static shape, or a step cannot be solved.
    """
    _require(rod, tendons, scenario, duration, tolerance)
    if method not in METHODS:
        raise SimulationError(f"There is no method {method!r}; give one of {', '.join(METHODS)}.")
    if method == "gauss" and step is None:
        raise SimulationError("The method 'gauss' does not choose its steps; give a step in s.")
    breaks = [0.0, rod.length, *(tendon.end for tendon in tendons), *scenario.places]
    if mesh is not None and not mesh.has(breaks):
        raise SimulationError("The mesh has no edge wherever something acts or ends; give one.")

    def first(mesh: Mesh) -> Equilibrium:
        equations = RodEquations.of(rod, tendons, mesh)
        acting = ScenarioLoads(scenario, equations)
        acting.take_hold(-1.0, np.zeros((mesh.edges.size - 1, 3)))
        return Equilibrium(equations, acting.at(0.0, -1.0))

    if start is None:
        shape = settle(first, rod, breaks, mesh)
        mesh, start = shape.mesh, (shape.strain, np.zeros_like(shape.strain))
    elif mesh is None:
        raise SimulationError("A start has no mesh with an edge wherever something acts; give it.")
    acting = ScenarioLoads(scenario, RodEquations.of(rod, tendons, mesh))
    run = _Run(acting, METHODS[method], tolerance * rod.length, step)
    with one_thread():
        return run.through(duration, np.array(start[0]), np.array(start[1]))


def _require(
    rod: Rod, tendons: Sequence[Tendon], scenario: Scenario, duration: float, tolerance: float
) -> None:
    if not (np.isfinite(duration) and duration > 0.0):
        raise SimulationError(f"A motion of {duration:g} s cannot be; give seconds above zero.")
    if not 0.0 < tolerance <= 0.01:
        raise SimulationError(f"A tolerance of {tolerance:g} cannot be; give up to 0.01.")
    if rod.mass_per_length <= 0.0:
        raise SimulationError("A rod without mass does not move by itself; give its density.")
    tensions = scenario.tensions(0.0) if callable(scenario.tensions) else scenario.tensions
    if scenario.displacements is not None:
        tensions = np.zeros(len(tendons))
        stiffness = np.asarray(scenario.tendon_stiffness, dtype=float)
        if stiffness.shape != (len(tendons),) or not np.all(stiffness > 0.0):
            raise SimulationError(
                f"tendon_stiffness is {stiffness.tolist()}; give N/m above zero, one a tendon."
            )
    wrenches = [timed.wrench for timed in scenario.wrenches]
    require_possible(rod, tendons, Loads(tensions, scenario.gravity, wrenches))
    for hold in scenario.holds:
        if not 0.0 < hold.arclength <= rod.length + 1e-12:
            raise SimulationError(
                f"A hold is at {hold.arclength:g} m, off a rod of {rod.length:g} m; move it."
            )


@dataclass
class _Run:
    """Integration of one motion: equations, method, and state carried between steps."""

    acting: ScenarioLoads
    method: Collocation
    tolerance: float  # m
    fixed: float | None
    slopes: Matrices = field(init=False)
    factors: dict[float, list[tuple[Array, Array]]] = field(default_factory=dict)
    stages: Array | None = None  # accelerations of the last step, whose length is `span`
    span: float = 0.0
    moments: list[Moment] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.back = np.linalg.inv(self.method.modes)
        self.square = self.method.A @ self.method.A

    def size(self, strain: Array) -> float:
        """Largest displacement (m) by changes of strain (…, G, 6), see `Matrices.moves`."""
        flat = strain.reshape(-1, self.acting.equations.size)
        return float(np.abs(flat @ self.slopes.moves.T).max())

    def through(self, duration: float, strain: Array, rate: Array) -> DynamicMotion:
        """Integrate from a state at 0 until `duration`, interval by interval between events."""
        events = self.acting.scenario.events
        inner = events[(events > 0.0) & (events < duration)]
        for begin, end in pairwise([0.0, *inner.tolist(), duration]):
            self.stages = None
            self._integrate_interval(begin, end, strain, rate)
            strain, rate = self.moments[-1].state[0], self.moments[-1].state[1]
        return DynamicMotion.of(self.acting, self.moments)

    def _integrate_interval(self, begin: float, end: float, strain: Array, rate: Array) -> None:
        """Integrate from one event to the next."""
        middle, time = 0.5 * (begin + end), begin
        self._append_start(begin, middle, strain, rate)
        step = self.fixed or min(_FIRST, end - begin)
        while time < end - 1e-12 * max(end, 1.0):
            if len(self.moments) > _STEPS or step < _SHORTEST:
                raise NoShapeError(
                    f"At {time:.4g} s the rod's motion cannot be followed: steps fell below "
                    f"{step:.2g} s; give contacts and holds less stiffness or more damping."
                )
            remaining = end - time
            reaches_end = self.fixed is not None or remaining <= step * (1.0 + 1e-9)
            span = min(step, remaining) if reaches_end else min(step, 0.5 * remaining)
            attempt = self._step(time, span, middle, strain, rate)
            if attempt is None:
                step = 0.3 * span
                continue
            accelerations, error, closing = attempt
            factor = 0.9 * (self.tolerance / max(error, 1e-300)) ** 0.2
            if error > self.tolerance and self.fixed is None:
                step = max(0.2, min(factor, 0.9)) * span
                continue
            time, strain, rate = time + span, closing.state[0], closing.state[1]
            self.moments.append(closing)
            self.stages, self.span = accelerations, span
            if self.fixed is not None:
                step = min(4.0 * span, self.fixed)
            elif factor > 1.3 or factor < 1.0:
                step = min(span * min(factor, 4.0), _LONGEST)

    def _append_start(self, time: float, middle: float, strain: Array, rate: Array) -> None:
        """Append the state at the beginning of an interval between events."""
        equations, state = self.acting.equations, np.stack([strain, rate, np.zeros_like(rate)])
        points = len(equations.rest)
        at = equations.at(state, self.acting.at(time, middle))
        self.acting.take_hold(middle, at.place[points:])
        instant = self.acting.at(time, middle)
        at = equations.at(state, instant)
        self._refresh(at, instant)
        self.moments.append(self._moment(time, state, at, instant, None))

    def _refresh(self, at: Balance, instant: AppliedLoads) -> None:
        self.slopes = matrices(self.acting.equations, at, instant)
        self.factors = {}

    def _refresh_at_last_state(self, time: float, middle: float) -> None:
        """Recompute the matrices at the last accepted state."""
        instant = self.acting.at(time, middle)
        self._refresh(self.acting.equations.at(self.moments[-1].state, instant), instant)

    def _factored(self, span: float) -> list[tuple[Array, Array]]:
        """LU factors of M + h λ D + h² λ² K for each eigenvalue λ with Im λ ≥ 0."""
        if span not in self.factors:
            mass, damping, stiffness, _ = self.slopes
            self.factors = {span: []}
            for value in self.method.values:
                if value.imag < -1e-12:
                    continue
                x = span * (value if value.imag > 1e-12 else value.real)
                matrix = mass + x * damping + x * x * stiffness
                self.factors[span].append(lu_factor(matrix, check_finite=False, overwrite_a=True))
        return self.factors[span]

    def _step(
        self, time: float, span: float, middle: float, strain: Array, rate: Array
    ) -> tuple[Array, float, Moment] | None:
        """Accelerations of the stages, error (m) and state at the end of a step; None on failure.

        If the iteration fails, it is repeated once with matrices at the last iterate.
        """
        instants = [self.acting.at(time + c * span, middle) for c in self.method.nodes]
        solved, states, balances, fast = self._newton(instants, span, strain, rate)
        if solved is None:
            self._refresh(balances[-1], instants[-1])
            solved, states, balances, fast = self._newton(instants, span, strain, rate)
        if solved is None:
            self._refresh_at_last_state(time, middle)
            return None
        error = self._error(solved, span)
        if not fast:
            self._refresh(balances[-1], instants[-1])
        last = self.method.extrapolate(np.ones(1))[0]
        end = np.stack(
            [
                strain
                + span * rate
                + span**2 * np.tensordot(self.method.b @ self.method.A, solved, 1),
                rate + span * np.tensordot(self.method.b, solved, 1),
                np.tensordot(last, solved, 1),
            ]
        )
        instant = self.acting.at(time + span, middle)
        at = self.acting.equations.at(end, instant)
        stages = list(zip(states, balances, instants, strict=True))
        power = np.stack([powers(self.acting.equations, *stage) for stage in stages])
        work = span * self.method.b @ power
        return solved, error, self._moment(time + span, end, at, instant, work)

    def _newton(
        self, instants: list[AppliedLoads], span: float, strain: Array, rate: Array
    ) -> tuple[Array | None, Array, list[Balance], bool]:
        """Solve the stages' balance by Newton's method.

        Returns accelerations (s, G, 6) or None, states and balances of the stages, and whether
        convergence was fast.
        """
        method, equations = self.method, self.acting.equations
        weights, shape = equations.mesh.weights[:, None], strain.shape
        acceleration = self._guess(span, shape)
        drift = strain + span * method.nodes[:, None, None] * rate
        before, fast = np.inf, True
        for count in range(_ITERATIONS):
            states = np.stack(
                [
                    drift + span**2 * np.tensordot(self.square, acceleration, 1),
                    rate + span * np.tensordot(method.A, acceleration, 1),
                    acceleration,
                ],
                axis=1,
            )
            balances = [equations.at(x, i) for x, i in zip(states, instants, strict=True)]
            work = np.stack([(weights * at.residual).ravel() for at in balances])
            change = self._solve(work, span).reshape(acceleration.shape)
            moved = self.size(span**2 * np.tensordot(self.square, change, 1))
            contraction = moved / before if np.isfinite(before) else 0.5
            if not np.isfinite(moved) or (count > 1 and contraction > 0.9):
                return None, states, balances, False
            acceleration = acceleration - change
            fast = fast and (count == 0 or contraction < 0.3)
            remaining = contraction / (1.0 - min(contraction, 0.9)) * moved
            if remaining < _NEWTON * self.tolerance:
                return acceleration, states, balances, fast
            before = moved
        return None, states, balances, False

    def _guess(self, span: float, shape: tuple[int, ...]) -> Array:
        """Initial accelerations (s, G, 6), extrapolated from the last step's polynomial."""
        if self.stages is None:
            return np.zeros((self.method.nodes.size, *shape))
        places = 1.0 + self.method.nodes * span / self.span
        return np.tensordot(self.method.extrapolate(places), self.stages, 1)

    def _solve(self, work: Array, span: float) -> Array:
        """Newton step (s, n) for weighted residuals (s, n), decoupled by the eigenvalues of A."""
        parts, change = self.back @ work, np.zeros(work.shape)
        factors = iter(self._factored(span))
        for k, value in enumerate(self.method.values):
            if value.imag < -1e-12:
                continue
            real = value.imag <= 1e-12
            right = parts[k].real if real else parts[k]
            solved = lu_solve(next(factors), right, check_finite=False)
            twice = 1.0 if real else 2.0
            change += twice * np.real(np.multiply.outer(self.method.modes[:, k], solved))
        return change

    def _error(self, stages: Array, span: float) -> float:
        """Position error of a step (m), from the jump of acceleration at its beginning.

        Source: Hairer and Wanner 1996, equation (IV.8.19), for the equation of second order.
        """
        real = int(np.argmin(np.abs(self.method.values.imag)))
        value = self.method.values[real].real
        if self.stages is None:
            return value**2 * self.size(span**2 * stages[-1])
        last = np.tensordot(self.method.extrapolate(np.ones(1))[0], self.stages, 1)
        first = np.tensordot(self.method.extrapolate(np.zeros(1))[0], stages, 1)
        place = sum(v.imag >= -1e-12 for v in self.method.values[:real])
        jump = self.slopes.mass @ (first - last).ravel()
        error = lu_solve(self._factored(span)[place], jump, check_finite=False)
        return self.size((value * span) ** 2 * error.reshape(first.shape))

    def _moment(
        self, time: float, state: Array, at: Balance, instant: AppliedLoads, work: Array | None
    ) -> Moment:
        total = np.zeros(3) if not self.moments else self.moments[-1].work
        return Moment(
            time,
            state,
            energies(self.acting.equations, state, at, instant.gravity),
            total if work is None else total + work,
            at.carried[:, -1],
            at.pull.max(axis=1, initial=0.0),
            work is None,
        )
