"""Gauss–Newton iteration with step control, over all unknowns at once.

Linearise every factor, factor the block-tridiagonal system, step. If the cost does not fall, try
the next step from there, else shorten the step by Levenberg–Marquardt damping. Stop when the
distance that remains after a step is a negligible fraction of a posterior standard deviation.
Source: equations (19) to (21).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.factors import Residuals
from glissando.model.field_checks import is_number
from glissando.model.priors.prior import Prior
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.damping import Damping, Step, saying_why
from glissando.solver.linearize import NormalEquations, gradient, linearize
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.normal_equations import system_shape
from glissando.solver.outcome import Outcome
from glissando.solver.step_lengths import StepLengths
from glissando.solver.step_search import WORTHWHILE, Where, try_step, whole_steps

_ROUGH = 10.0  # error allowed in a rough start, standard deviations per unknown
_ROUGH_ITERATIONS = 15
_PASSING = 0.01  # error allowed in an intermediate estimate, standard deviations per unknown

Progress = Callable[[int, float, float], None]
"""Called after each iteration with its number, the cost and the step in standard deviations."""


@dataclass(frozen=True)
class SolverOptions:
    """Stopping criteria: `max_iterations`, or a remaining distance below `tolerance`.

    Distances are Mahalanobis distances of the whole state, in posterior standard deviations, so
    that each of a thousand unknowns moves by far less than the tolerance.

    Attributes:
        max_iterations: Most iterations, after the rough ones over few time nodes that find a
            start; a report counts both.
        tolerance: Remaining distance that is negligible, standard deviations.
        settled: Iterations after which weights are fixed, so that the cost can only fall.
    """

    max_iterations: int = 100
    tolerance: float = 0.3
    settled: int = 10

    def is_rough(self, numbers: int) -> bool:
        """Whether the tolerance allows an error of one standard deviation in every unknown."""
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
        """Options for a start that may be off by several standard deviations per unknown."""
        return SolverOptions(_ROUGH_ITERATIONS, _ROUGH * float(np.sqrt(numbers)))

    def rougher(self, numbers: int, off: float = _PASSING) -> SolverOptions:
        """Options for an intermediate estimate, to `off` standard deviations per unknown."""
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
    """State at which the iteration ended, and the factored system that gives its covariance.

    Attributes:
        state: Nodes (K, N).
        located: Readings with the estimated sensor parameters.
        equations: The last linearisation.
        cholesky: Factor of the last linearisation.
        cost: Cost at `state`, to second order.
        outcome: Outcome of the iteration.
        iterations: Number of iterations.
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
        """Memory of this solution, to be reused by a system of at most as many unknowns.

        Args:
            size: Unknowns of a slab of that system.
        """
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
        options: Stopping criteria.
        progress: Called after each iteration.
        clock: Stopwatch of the phases.
        former: Solution of at least as many unknowns, no longer needed: its memory is overwritten.

    Raises:
        UnobservableError: A direction of the state is undetermined, or lost in rounding.
    """
    with saying_why(determined=prior.fixes_base):
        return _Iteration(prior, located, start, options, clock, former).run(progress)


class _Iteration:
    """State of an iteration: the current linearisation and the history of its steps."""

    def __init__(
        self,
        prior: Prior,
        located: LocatedReadings,
        start: State,
        options: SolverOptions,
        clock: Stopwatch,
        former: Solution | None,
    ) -> None:
        self._prior, self._options, self._clock = prior, options, clock
        self._workspace, self._cholesky = _memory(located, start, former)
        self._here = self._at((start, located))
        self._fixed: NormalEquations | None = None  # linearisation whose weights are kept
        self._renewed: Array | None = None  # the last step that followed renewed weights
        self._steps = StepLengths(options.tolerance, kinks=located.moves, weighted=located.weighted)
        self._damping, self._count, self._bent = Damping(determined=prior.fixes_base), 0, False

    def run(self, progress: Progress | None) -> Solution:
        """Take steps until a stopping criterion is met."""
        while True:
            way = self._next_step(progress)
            here, of_here = self._here, self._fixed is None or self._fixed is self._here
            if self._steps.short and (of_here or self._steps.last):
                end = self._confirmed_end(way)
                if end is not None:
                    return self._solution(end, way.cholesky, Outcome.CONVERGED, way.predicted)
            elif self._steps.short:
                self._here = self._fixed = self._at((here.state, here.located))
                continue
            outcome = self._take(way)
            if outcome is not None:
                here = self._here
                cholesky = factor(here.system, way.cholesky)
                return self._solution((here.state, here.located), cholesky, outcome)

    def _next_step(self, progress: Progress | None) -> Step:
        """Solve for the next step and record its length."""
        here, renewed = self._here, self._fixed is self._here
        with self._clock("solve"):
            way = self._damping.step(here, self._cholesky)
        self._cholesky, self._count = way.cholesky, self._count + 1
        if progress is not None:
            progress(self._count, here.cost_of(here), way.length)
        turns_back = self._renewed is not None and bool(np.vdot(here.rhs, self._renewed) < 0.0)
        self._steps.note(way.length, damped=way.damped, renewed=renewed, turns_back=turns_back)
        self._renewed = way.step if renewed else self._renewed
        return way

    def _confirmed_end(self, way: Step) -> Where | None:
        """End of a short step if the next step from there is as short as predicted, else None."""
        sure = self._options.is_rough(self._here.rhs.size) or not self._steps.doubtful
        for end in whole_steps(self._prior, self._here, way.step):
            if sure or self._steps.confirms(self._next_length(end, way.cholesky)):
                return end
        return None

    def _next_length(self, end: Where, cholesky: Cholesky) -> float:
        """Length of the next step, from the gradient at `end` and the factor before."""
        with self._clock("linearise"):
            rhs = gradient(self._prior, end[1], end[0], *_weights(end, self._fixed))
        return float(np.sqrt(np.sum(rhs * cholesky.solve(rhs))))

    def _take(self, way: Step) -> Outcome | None:
        """Take the step as far as the cost falls; the outcome if the iteration ends, else None."""
        if self._count == self._options.settled:
            self._fixed = self._here
        self._here, gain, self._bent = try_step(
            self._prior, self._here, way.step, self._fixed, way.predicted, self._at, bent=self._bent
        )
        self._damping.adapt(gain)
        settled = self._steps.idle and not gain > WORTHWHILE
        if self._fixed is not None and self._steps.stall(self._here.cost_of(self._here)):
            settled |= self._here.located.moves or self._is_damped_near_minimum(way.cholesky)
        if settled:
            return Outcome.CONVERGED
        if self._damping.exhausted:
            return Outcome.NO_DESCENT
        return Outcome.ITERATION_LIMIT if self._count >= self._options.max_iterations else None

    def _is_damped_near_minimum(self, memory: Cholesky) -> bool:
        """Whether the last steps were damped and a whole one with renewed weights is negligible."""
        if not self._steps.creep:
            return False
        here = self._here = self._fixed = self._at((self._here.state, self._here.located))
        whole = factor(here.system, memory).solve(here.rhs)
        return bool(np.sum(whole * here.rhs) < self._options.tolerance**2)

    def _at(self, where: Where, fixed: NormalEquations | None = None) -> NormalEquations:
        noise_state, weights = _weights(where, fixed)
        with self._clock("linearise"):
            return linearize(self._prior, where[1], where[0], noise_state, self._workspace, weights)

    def _solution(
        self, end: Where, cholesky: Cholesky, outcome: Outcome, fall: float = 0.0
    ) -> Solution:
        here, lengths = self._here, (self._steps.first, self._steps.length)
        cost = here.cost_of(here) - fall
        return Solution(*end, here, cholesky, cost, outcome, self._count, *lengths, self._workspace)


def _weights(where: Where, fixed: NormalEquations | None) -> tuple[State, list[Residuals] | None]:
    """State that weights are computed from, and terms whose weights are kept, or None."""
    return (where[0], None) if fixed is None else (fixed.noise_state, fixed.terms)


def _memory(
    located: LocatedReadings, start: State, former: Solution | None
) -> tuple[Array, Cholesky | None]:
    """Memory of all systems and of a factor, as allocating anew would cost more than the sums."""
    size = located.parameters.process.size + start.numbers
    if former is not None:
        return former.memory(size)
    return np.empty(system_shape(start.pose.shape[0], size)), None
