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

    Raises:
        UnobservableError: Something is undetermined, or lost in rounding.
    """
    with saying_why(determined=prior.fixes_base):
        return _Iteration(prior, located, start, options, clock, former).run(progress)


class _Iteration:
    """A problem where its iteration stands, and what its steps have shown so far."""

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
        self._fixed: NormalEquations | None = None  # whose weights are kept, if they are
        self._renewed: Array | None = None  # the last step that followed renewed weights
        self._steps = StepLengths(options.tolerance, kinks=located.moves, weighted=located.weighted)
        self._damping, self._count, self._bent = Damping(determined=prior.fixes_base), 0, False

    def run(self, progress: Progress | None) -> Solution:
        """Take steps until it ends."""
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
        """The next step, its length noted."""
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
        """Where a short step leads, if the next one from there is as short as it promised."""
        sure = self._options.is_rough(self._here.rhs.size) or not self._steps.doubtful
        for end in whole_steps(self._prior, self._here, way.step):
            if sure or self._steps.confirms(self._next_length(end, way.cholesky)):
                return end
        return None

    def _next_length(self, end: Where, cholesky: Cholesky) -> float:
        """Length of the step that would follow, by the gradient and the system before."""
        with self._clock("linearise"):
            rhs = gradient(self._prior, end[1], end[0], *_weights(end, self._fixed))
        return float(np.sqrt(np.sum(rhs * cholesky.solve(rhs))))

    def _take(self, way: Step) -> Outcome | None:
        """Go where the step leads, as far as that is worth it; how the iteration ends, if so."""
        if self._count == self._options.settled:
            self._fixed = self._here
        self._here, gain, self._bent = try_step(
            self._prior, self._here, way.step, self._fixed, way.predicted, self._at, bent=self._bent
        )
        self._damping.adapt(gain)
        settled = self._steps.idle and not gain > WORTHWHILE
        if self._fixed is not None and self._steps.stall(self._here.cost_of(self._here)):
            settled |= self._here.located.moves or self._creeps_to_its_end(way.cholesky)
        if settled:
            return Outcome.CONVERGED
        if self._damping.exhausted:
            return Outcome.NO_DESCENT
        return Outcome.ITERATION_LIMIT if self._count >= self._options.max_iterations else None

    def _creeps_to_its_end(self, memory: Cholesky) -> bool:
        """Whether steps are damped, and a whole one with renewed weights would be negligible."""
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
    """The state that weights come from, and the terms whose weights are kept, if they are."""
    return (where[0], None) if fixed is None else (fixed.noise_state, fixed.terms)


def _memory(
    located: LocatedReadings, start: State, former: Solution | None
) -> tuple[Array, Cholesky | None]:
    """One memory for all systems, as fresh memory would cost more than the sums, and a factor's."""
    size = located.parameters.process.size + start.numbers
    if former is not None:
        return former.memory(size)
    return np.empty(system_shape(start.pose.shape[0], size)), None
