"""The method: Gauss–Newton with a trust region on the whole recording.

Linearise every factor, assemble, factor the block-tridiagonal system, step; shorten the step by
Levenberg–Marquardt damping when the cost does not fall; stop when a step is a negligible fraction
of a posterior standard deviation. The covariance comes from the last factor. Source: (20), (21).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import NotConvergedWarning, OutsideGridError, SensorError, UnobservableError
from glissando.estimation.posterior import Posterior, SolveReport
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.measurement_factors import MeasurementFactors
from glissando.solver.normal_equations import slab_shape
from glissando.twins import estimating

_WORTHWHILE = 1e-3  # share of the predicted fall in cost below which a step is refused
_SHORTER = (0.5, 0.2)  # parts of a refused step that are tried
_SETTLED = 10  # iterations after which weights are held, so that the cost can only fall
_ROUNDS = 5  # times they are renewed after that
_ROUNDING = 1e-11  # a fall in cost this small, relatively, cannot be told from rounding
_DAMPING = (1e-4, 1e8)  # smallest damping worth applying, and the one at which to give up
_ROUGH = 10.0  # standard deviations a number that a rough start may be off by
_ROUGH_ITERATIONS = 15
_NOT_CONVERGED = "not converged: {} iterations, the last step still {:.2g} standard deviations long"

Progress = Callable[[int, float, float], None]
"""Called after each iteration with its number, the cost and the step in standard deviations."""


@dataclass(frozen=True)
class SolverOptions:
    """When to stop: after `max_iterations`, or when a step is shorter than `tolerance`.

    A step's length is in posterior standard deviations, over the whole state at once, so that the
    mean of a thousand unknowns moves by far less than this in any of them.
    """

    max_iterations: int = 100
    tolerance: float = 0.3


def estimate(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    *,
    sensor_parameters: Sequence[SensorParameter] = (),
    initial: State | None = None,
    options: SolverOptions = SolverOptions(),
    progress: Progress | None = None,
) -> Posterior:
    """Posterior over pose, strain and velocity on `grid` given a prior and readings.

    `sensor_parameters`, matched by the readings' names, are estimated with the states where they
    are uncertain, and applied where they are known.
    Starts from `initial`, else from the robot at rest, first with shear and extension softened
    where they are stiff: stiff ones make a bend a long walk along a narrow valley. Warns
    NotConvergedWarning when it stops early (the posterior says so too); raises OutsideGridError for
    readings off the grid and UnobservableError when prior and readings leave a direction
    undetermined.
    """
    clock = Stopwatch()
    if isinstance(readings, Readings):
        raise SensorError("Readings go in a list, a sensor each: estimate(prior, grid, [coil]).")
    if initial is not None and initial.pose.shape[:2] != grid.shape:
        raise OutsideGridError(
            f"The initial state has {initial.pose.shape[:2]} nodes and the grid {grid.shape}; give "
            f"a state of this grid."
        )
    if not prior.fixes_base and not any(r.fixes_base and len(r) for r in readings):
        raise UnobservableError(
            "Nothing fixes the base: the robot has no [base] and no pose, coil or position stream "
            "is used. Give the robot a [base], or use a stream that fixes it."
        )
    with estimating():
        unmoved = [u for u in sensor_parameters if u.known]
        placed = MeasurementFactors(
            grid, [corrected(r, unmoved) for r in readings], sensor_parameters
        )
        start, before = initial, 0
        if start is None:
            start, placed, before = _rough(prior, placed, progress, clock)
        found = _iterate(prior, placed, start, options, _counted(progress, before), clock)
        found = replace(found, iterations=before + found.iterations)
        with clock("covariance"):
            marginals = found.chol.marginals(consume=True)
    solve = found.solve(clock)
    if not solve.converged:
        warnings.warn(
            f"The estimate has {solve.status}. Try a finer time grid, a robust loss, a start "
            f"nearer the shape, or more iterations.",
            NotConvergedWarning,
            stacklevel=2,
        )
    return Posterior(
        prior, grid, found.state, found.at.system, marginals, solve, found.placed.known_now()
    )


def _counted(progress: Progress | None, before: int) -> Progress | None:
    """The same progress, told that so many iterations went before."""
    if progress is None or before == 0:
        return progress
    return lambda iteration, cost, length: progress(before + iteration, cost, length)


def _rough(
    prior: Prior, placed: MeasurementFactors, progress: Progress | None, clock: Stopwatch
) -> tuple[State, MeasurementFactors, int]:
    """Where to start: at rest, or where steps with a softer prior lead from there; how many."""
    rest = prior.rest_state(placed.grid)
    soft = prior.softened()
    if soft is prior:
        return rest, placed, 0
    size = rest.strain[..., 0].size * rest.dof
    options = SolverOptions(
        max_iterations=_ROUGH_ITERATIONS, tolerance=_ROUGH * float(np.sqrt(size))
    )
    found = _iterate(soft, placed, rest, options, progress, clock)
    return found.state, found.placed, found.iterations


class Stopwatch:
    """Seconds of processor time by phase: `with clock("solve"): …`."""

    def __init__(self) -> None:
        self.seconds = {"linearise": 0.0, "solve": 0.0, "covariance": 0.0}
        self._began = time.process_time()

    def __call__(self, phase: str) -> Stopwatch:
        """Name the phase about to be timed."""
        self._phase = phase
        return self

    def __enter__(self) -> None:
        self._start = time.process_time()

    def __exit__(self, *_: object) -> None:
        self.seconds[self._phase] += time.process_time() - self._start

    def total(self) -> dict[str, float]:
        """Seconds by phase and in total."""
        return {**self.seconds, "total": time.process_time() - self._began}


@dataclass(frozen=True)
class _Found:
    """Where the iteration ended, and the factored system its covariance comes from."""

    state: State
    placed: MeasurementFactors
    at: NormalEquations
    chol: Cholesky
    status: str
    iterations: int

    def solve(self, clock: Stopwatch) -> SolveReport:
        """The record of the solve that goes with the posterior."""
        cost = self.at.cost_of(self.at)
        noise = sum(terms.log_det_cov() for terms in self.at.terms)
        evidence = -cost - 0.5 * (noise + self.chol.log_det)
        suspects = sum(int(np.sum(terms.robust_weights() < 0.5)) for terms in self.at.terms)
        sensor_parameters = self.at.right.size
        return SolveReport(
            self.status, self.iterations, sensor_parameters, cost, evidence, suspects, clock.total()
        )


def _iterate(
    prior: Prior,
    placed: MeasurementFactors,
    start: State,
    options: SolverOptions,
    progress: Progress | None,
    clock: Stopwatch,
) -> _Found:
    """Gauss-Newton steps, damped when the cost does not fall (Marquardt's scaling)."""
    # Room for every system: fresh memory would cost more than the sums.
    room = np.empty(slab_shape(placed.grid, start.dof, placed.sensor_parameters.size))

    def at(to: _Where, held: NormalEquations | None = None) -> NormalEquations:
        about, terms = (to[0], None) if held is None else (held.about, held.terms)
        with clock("linearise"):
            return linearize(prior, to[1], to[0], about, room, terms)

    here, held, chol, damping, iteration, rounds = at((start, placed)), None, None, 0.0, 0, 0
    while True:
        with clock("solve"):
            chol, step, length, predicted = _step(here, damping, chol)
        iteration += 1
        if progress is not None:
            progress(iteration, here.cost_of(here), length)
        candidates = _candidates(prior, here, step)
        short = length < options.tolerance
        fresh = held is None or held.state is here.state or rounds == _ROUNDS
        if short and fresh and damping == 0.0:
            return _Found(*next(candidates)[0], here, chol, "converged", iteration)
        if iteration >= _SETTLED and (held is None or short) and rounds < _ROUNDS:
            held, rounds = _renewed(here, held, at), rounds + 1
        here, gain = _try_step(here, candidates, held, predicted, at)
        damping = _next_damping(damping, gain)
        if iteration == options.max_iterations or damping > _DAMPING[1]:
            status = _NOT_CONVERGED.format(iteration, length)
            chol = factor(here.system, chol)
            return _Found(here.state, here.placed, here, chol, status, iteration)


def _step(
    here: NormalEquations, damping: float, room: Cholesky | None
) -> tuple[Cholesky, Array, float, float]:
    """The factor, the damped step, its length in standard deviations, the fall it promises."""
    extra = damping * np.einsum("kii->ki", here.system.diagonal)
    chol = factor(here.system.add_to_diagonal(extra) if damping else here.system, room)
    step = chol.solve(here.right)
    length = float(np.sqrt(np.maximum(np.sum(step * (here.right - extra * step)), 0.0)))
    return chol, step, length, 0.5 * float(np.sum(step * (here.right + extra * step)))


_Where = tuple[State, MeasurementFactors]
"""A state, and the readings where the unknowns that go with it put them."""


def _candidates(prior: Prior, here: NormalEquations, step: Array) -> Iterator[tuple[_Where, float]]:
    """Where a step may lead, and the share of its promise: straight on, bent, or bent and shorter.

    A long step straight on tears poses and strains apart, which stiff priors punish; bent, poses
    still follow from the strains. Along a curved valley a shorter one is better than a damped one.
    """
    of_nodes, of_unknowns = here.split(step)
    placed = here.placed.moved(of_unknowns)
    yield (here.state.retract(of_nodes), placed), 1.0
    yield (prior.bent(placed.grid, here.state, of_nodes), placed), 1.0
    for part in _SHORTER:
        placed = here.placed.moved(part * of_unknowns)
        bent = prior.bent(placed.grid, here.state, part * of_nodes)
        yield (bent, placed), part * (2.0 - part)


_At = Callable[[_Where, NormalEquations | None], NormalEquations]


def _renewed(
    here: NormalEquations, held: NormalEquations | None, at: _At
) -> NormalEquations | None:
    """The problem whose weights are held from now on: this one, if it has weights of its own."""
    try:
        return at((here.state, here.placed), None)
    except np.linalg.LinAlgError:
        return held


def _try_step(
    here: NormalEquations,
    candidates: Iterable[tuple[_Where, float]],
    held: NormalEquations | None,
    predicted: float,
    at: _At,
) -> tuple[NormalEquations, float]:
    """The problem at the first candidate worth it, else as it was; and the share of the promise."""
    cost = here.cost_of(here)
    gain = -1.0
    for candidate, share in candidates:
        try:
            there = at(candidate, held)
        except np.linalg.LinAlgError:  # so far off that not even its weights exist
            continue
        if predicted < _ROUNDING * (1.0 + cost):
            return there, 1.0
        gain = (cost - here.cost_of(there)) / (share * predicted)
        if gain > _WORTHWHILE:
            return there, gain
    return at((here.state, here.placed), held), gain


def _next_damping(damping: float, gain: float) -> float:
    """Less damping after a step that kept its promise, more after one that did not (Nielsen 1999).

    Shrinking in proportion to how well the promise was kept avoids refusing every other step.
    """
    if not gain > _WORTHWHILE:  # NaN included
        return max(_DAMPING[0], 4.0 * damping)
    shrunk = damping * max(0.2, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
    return 0.0 if shrunk < _DAMPING[0] else shrunk
