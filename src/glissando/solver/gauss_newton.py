"""Gauss–Newton with a trust region on the whole problem.

Linearise every factor, factor the block-tridiagonal system, step; when the cost does not fall, look
where the next step from there leads, else shorten the step by Levenberg–Marquardt damping; stop
when what a step leaves to go is a negligible fraction of a posterior standard deviation. Source:
equations (19) to (21).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.priors.prior import Prior
from glissando.model.state import State
from glissando.model.stated import is_number
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.damping import Damping
from glissando.solver.linearize import NormalEquations, gradient, linearize
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.normal_equations import system_shape
from glissando.solver.outcome import Outcome
from glissando.solver.step_lengths import StepLengths
from glissando.solver.step_search import WORTHWHILE, Where, candidates, try_step

_ROUGH = 10.0  # standard deviations a number that a rough start may be off by
_ROUGH_ITERATIONS = 15
_PASSING = 0.01  # standard deviations a number that what is only looked at may be off by

Progress = Callable[[int, float, float], None]
"""Called after each iteration with its number, the cost and the step in standard deviations."""


@dataclass(frozen=True)
class SolverOptions:
    """When to stop: after `max_iterations`, or when what is left to go is below `tolerance`.

    Lengths are in posterior standard deviations, over the whole state at once, so that the mean of
    a thousand unknowns moves by far less than this in any of them.

    Attributes:
        max_iterations: Most iterations, after the rough ones over few time nodes that find a
            start; a report counts those, too.
        tolerance: Length of a way that is negligible, standard deviations.
        settled: Iterations after which weights are fixed, so that the cost can only fall.
    """

    max_iterations: int = 100
    tolerance: float = 0.3
    settled: int = 10

    def is_rough(self, numbers: int) -> bool:
        """Whether a state of so many numbers may be off by a standard deviation in each."""
        return self.tolerance >= float(np.sqrt(numbers))

    def __post_init__(self) -> None:
        for name, least in (("max_iterations", 1), ("settled", 0)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < least:
                raise GlissandoError(f"SolverOptions: {name} is {value!r}; give {least} or more.")
        if not is_number(self.tolerance) or not self.tolerance > 0.0:
            raise GlissandoError(
                f"SolverOptions: tolerance is {self.tolerance!r}; give standard deviations."
            )

    @staticmethod
    def rough(numbers: int) -> SolverOptions:
        """Options for a start that may be off by several standard deviations a number."""
        return SolverOptions(_ROUGH_ITERATIONS, _ROUGH * float(np.sqrt(numbers)))

    def rougher(self, numbers: int, off: float = _PASSING) -> SolverOptions:
        """The same for a passing estimate, which may be `off` by standard deviations a number."""
        return replace(self, tolerance=max(self.tolerance, off * float(np.sqrt(numbers))))


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
class Solution:
    """Where the iteration ended, and the factored system its covariance comes from.

    Attributes:
        state: Nodes (K, N).
        located: The readings, with the sensor parameters estimated.
        equations: The last linearisation.
        cholesky: Its factor.
        cost: The cost where it ended, to second order.
        outcome: How it ended.
        iterations: How many it took.
        first_step: Length of the first step, standard deviations.
        last_step: Length of the last step.
        workspace: Memory of the system.
    """

    state: State
    located: LocatedReadings
    equations: NormalEquations
    cholesky: Cholesky
    cost: float
    outcome: Outcome
    iterations: int
    first_step: float
    last_step: float
    workspace: Array

    def memory(self, size: int) -> tuple[Array, Cholesky]:
        """Its own, to be overwritten, for a system of `size` numbers a slab, not above its own."""
        count, square = len(self.cholesky.inverse), size * size
        parts = (self.workspace, 2 * count - 1), (self.cholesky.inverse, count)
        workspace, inverse, coupling = (
            memory.reshape(-1)[: slabs * square].reshape(slabs, size, size)
            for memory, slabs in (*parts, (self.cholesky.coupling, count - 1))
        )
        return workspace, Cholesky(inverse, coupling)


def minimize(
    prior: Prior,
    located: LocatedReadings,
    start: State,
    options: SolverOptions,
    progress: Progress | None,
    clock: Stopwatch,
    former: Solution | None = None,
) -> Solution:
    """Gauss–Newton steps, damped when the cost does not fall (Marquardt's scaling).

    Args:
        prior: The prior.
        located: The readings.
        start: Nodes (K, N) to start from.
        options: When to stop.
        progress: Called after each iteration.
        clock: Times the phases.
        former: A solution of no fewer numbers whose memory is overwritten, as it is not needed.
    """
    workspace, cholesky = _memory(located, start, former)

    def at(where: Where, fixed: NormalEquations | None = None) -> NormalEquations:
        noise_state = where[0] if fixed is None else fixed.noise_state
        weights = None if fixed is None else fixed.terms
        with clock("linearise"):
            return linearize(prior, where[1], where[0], noise_state, workspace, weights)

    here, fixed = at((start, located)), None
    steps = StepLengths(options.tolerance, kinks=located.moves, weighted=located.weighted)
    damping, iteration, bent = Damping(determined=prior.fixes_base), 0, False

    def solution(end: Where, cholesky: Cholesky, outcome: Outcome, fall: float = 0.0) -> Solution:
        cost, lengths = here.cost_of(here) - fall, (steps.first, steps.length)
        return Solution(*end, here, cholesky, cost, outcome, iteration, *lengths, workspace)

    while True:
        with clock("solve"):
            way = damping.step(here, cholesky)
        cholesky, iteration = way.cholesky, iteration + 1
        if progress is not None:
            progress(iteration, here.cost_of(here), way.length)
        steps.note(way.length, damped=way.damped, renewed=fixed is here)
        if steps.short and (fixed is None or fixed is here or steps.last):
            end = next(candidates(prior, here, way.step)).where
            rough = options.is_rough(here.rhs.size)
            if rough or not steps.doubtful or _confirmed(prior, end, cholesky, steps, clock):
                return solution(end, cholesky, Outcome.CONVERGED, way.predicted)
        elif steps.short:
            here = fixed = at((here.state, here.located))
            continue
        if iteration == options.settled:
            fixed = here
        here, gain, bent = try_step(prior, here, way.step, fixed, way.predicted, at, bent=bent)
        damping.adapt(gain)
        settled = steps.idle and not gain > WORTHWHILE
        settled |= fixed is not None and steps.stall(here.cost_of(here))
        ended = _ended(settled, damping, iteration, options)
        if ended is not None:
            return solution((here.state, here.located), factor(here.system, cholesky), ended)


def _confirmed(
    prior: Prior, end: Where, cholesky: Cholesky, steps: StepLengths, clock: Stopwatch
) -> bool:
    """Whether the next step from an end, by its gradient, is as short as the last one promised."""
    with clock("linearise"):
        rhs = gradient(prior, end[1], end[0])
    return steps.confirms(float(np.sqrt(np.sum(rhs * cholesky.solve(rhs)))))


def _ended(
    settled: bool, damping: Damping, iteration: int, options: SolverOptions
) -> Outcome | None:
    """How the iteration has ended, if it has: settled, damped in vain, or at its limit."""
    if settled:
        return Outcome.CONVERGED
    if damping.in_vain:
        return Outcome.NO_DESCENT
    return Outcome.ITERATION_LIMIT if iteration >= options.max_iterations else None


def _memory(
    located: LocatedReadings, start: State, former: Solution | None
) -> tuple[Array, Cholesky | None]:
    """One memory for all systems, as fresh memory would cost more than the sums, and a factor's."""
    size = located.parameters.process.size + start.numbers
    if former is not None:
        return former.memory(size)
    return np.empty(system_shape(start.pose.shape[0], size)), None
