"""Gauss–Newton with a trust region on the whole problem.

Linearise every factor, factor the block-tridiagonal system, step; when the cost does not fall, look
where the next step from there leads, else shorten the step by Levenberg–Marquardt damping; stop
when a step is a negligible fraction of a posterior standard deviation. Source: equations (19) to
(21).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.priors.prior import Prior
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.located_readings import LocatedReadings
from glissando.solver.normal_equations import system_shape
from glissando.solver.outcome import Outcome
from glissando.solver.step_lengths import StepLengths

WORTHWHILE = 1e-3  # share of the predicted fall in cost below which a step is refused
_GOOD = 0.25  # share above which no other way to take the step is tried
ROUNDING = 1e-11  # a fall in cost this small, relatively, cannot be told from rounding
_SHORTER = (0.5, 0.2)  # parts of a refused step that are tried
_PLAIN, _FARTHEST = 2.0, 8.0  # a stretch of a step below which it is as good; and the longest
_DAMPING = (1e-4, 1e8)  # smallest damping worth applying, and the one at which to give up
_ROUGH = 10.0  # standard deviations a number that a rough start may be off by
_ROUGH_ITERATIONS = 15
_PASSING = 0.01  # standard deviations a number that what is only looked at may be off by

Progress = Callable[[int, float, float], None]
"""Called after each iteration with its number, the cost and the step in standard deviations."""


@dataclass(frozen=True)
class SolverOptions:
    """When to stop: after `max_iterations`, or when a step is shorter than `tolerance`.

    A step's length is in posterior standard deviations, over the whole state at once, so that the
    mean of a thousand unknowns moves by far less than this in any of them.

    Attributes:
        max_iterations: Most iterations, after the rough ones over few time nodes that find a
            start; a report counts those, too.
        tolerance: Length of a step that is negligible, standard deviations.
        settled: Iterations after which weights are fixed, so that the cost can only fall.
    """

    max_iterations: int = 100
    tolerance: float = 0.3
    settled: int = 10

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


_Where = tuple[State, LocatedReadings]
"""A state, and the readings where the sensor parameters that go with it put them."""

_Linearize = Callable[[_Where, NormalEquations | None], NormalEquations]


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

    def at(where: _Where, fixed: NormalEquations | None = None) -> NormalEquations:
        noise_state = where[0] if fixed is None else fixed.noise_state
        weights = None if fixed is None else fixed.terms
        with clock("linearise"):
            return linearize(prior, where[1], where[0], noise_state, workspace, weights)

    here, fixed = at((start, located)), None
    steps = StepLengths(options.tolerance, kinks=located.moves)
    damping, iteration, stretch = 0.0, 0, 1.0

    def solution(end: _Where, cholesky: Cholesky, outcome: Outcome) -> Solution:
        lengths = steps.first, steps.length
        return Solution(*end, here, cholesky, outcome, iteration, *lengths, workspace)

    while True:
        with clock("solve"):
            cholesky, step, length, predicted = _step(here, damping, cholesky)
        iteration += 1
        if progress is not None:
            progress(iteration, here.cost_of(here), length)
        steps.note(length, damped=damping > 0.0, renewed=fixed is here)
        if steps.short and (fixed is None or fixed is here or steps.last):
            end = next(_candidates(prior, here, step))[0]
            return solution(end, cholesky, Outcome.CONVERGED)
        if steps.short:
            here = fixed = at((here.state, here.located))
            continue
        if iteration == options.settled:
            fixed = here
        stretch = 1.0 if damping else stretch
        here, gain, stretch = _try_step(prior, here, step, fixed, predicted, at, stretch)
        damping = _next_damping(damping, gain)
        ended = _ended(steps.idle and not gain > WORTHWHILE, damping, iteration, options)
        if ended is not None:
            return solution((here.state, here.located), factor(here.system, cholesky), ended)


def _ended(settled: bool, damping: float, iteration: int, options: SolverOptions) -> Outcome | None:
    """How the iteration has ended, if it has: settled, damped in vain, or at its limit."""
    if settled:
        return Outcome.CONVERGED
    if damping > _DAMPING[1]:
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


def _step(
    here: NormalEquations, damping: float, workspace: Cholesky | None
) -> tuple[Cholesky, Array, float, float]:
    """The factor, the damped step, its length in standard deviations, the fall it promises."""
    extra = damping * np.einsum("kii->ki", here.system.diagonal)
    cholesky = factor(here.system.add_to_diagonal(extra) if damping else here.system, workspace)
    step = cholesky.solve(here.rhs)
    length = float(np.sqrt(np.maximum(np.sum(step * (here.rhs - extra * step)), 0.0)))
    return cholesky, step, length, 0.5 * float(np.sum(step * (here.rhs + extra * step)))


def _candidates(prior: Prior, here: NormalEquations, step: Array) -> Iterator[tuple[_Where, float]]:
    """Where a step may lead, and the share of its promise: straight on, bent, or bent and shorter.

    A long step straight on tears poses and strains apart, which stiff priors punish; bent, poses
    still follow from the strains. Along a curved valley a shorter one is better than a damped one.
    """
    of_nodes, of_parameters = here.split(step)
    located = here.located.moved(of_parameters)
    yield (here.state.retract(of_nodes), located), 1.0
    yield (prior.bent(located.grid, here.state, of_nodes), located), 1.0
    for part in _SHORTER:
        located = here.located.moved(part * of_parameters)
        bent = prior.bent(located.grid, here.state, part * of_nodes)
        yield (bent, located), part * (2.0 - part)


def _try_step(
    prior: Prior,
    here: NormalEquations,
    step: Array,
    fixed: NormalEquations | None,
    predicted: float,
    at: _Linearize,
    stretch: float,
) -> tuple[NormalEquations, float, float]:
    """The problem at the first way worth it, else as it was; the share of the promise; a stretch.

    Where steps keep more than they promise, the cost curves less than residuals without their
    second derivatives say, and a stretched step is tried first.
    """
    cost, best, best_gain = here.cost_of(here), (here.state, here.located), WORTHWHILE
    if stretch > 1.0 and predicted > ROUNDING * (1.0 + cost):
        of_nodes, of_parameters = here.split(stretch * step)
        with suppress(np.linalg.LinAlgError):
            there = at((here.state.retract(of_nodes), here.located.moved(of_parameters)), fixed)
            gain = (cost - here.cost_of(there)) / predicted
            if gain > _PLAIN:
                return there, gain, _next_stretch(stretch, gain)
    gain = -1.0
    for there, where, share in _ways(prior, here, step, fixed, at):
        if predicted < ROUNDING * (1.0 + cost):
            return there, 1.0, 1.0
        gain = (cost - here.cost_of(there)) / (share * predicted)
        if gain > _GOOD:
            return there, gain, _next_stretch(1.0, gain) if stretch == 1.0 else 1.0
        if gain > best_gain:
            best, best_gain = where, gain
    gain = best_gain if best_gain > WORTHWHILE else gain
    return at(best, fixed), gain, 1.0


def _next_stretch(stretch: float, gain: float) -> float:
    """How many Gauss–Newton steps away the least cost lies, as the gain of the last one tells.

    Where the cost curves c times as much as Gauss–Newton assumes, a step α times as long gains
    2 α − c α² of what a plain one promises, most at α = 1/c.
    """
    curvature = (2.0 * stretch - gain) / stretch**2
    return 1.0 if curvature > 1.0 / _PLAIN else 1.0 / max(curvature, 1.0 / _FARTHEST)


def _ways(
    prior: Prior,
    here: NormalEquations,
    step: Array,
    fixed: NormalEquations | None,
    at: _Linearize,
) -> Iterator[tuple[NormalEquations, _Where, float]]:
    """The problem where each candidate leads, as far as its weights exist, and its share.

    Last comes where a second step from the first candidate leads. A step along the tangent of a
    narrow valley ends high on its side and shorter ones gain little; the next step from there falls
    back into the valley, farther on (Chamberlain et al., The watchdog technique, 1982).
    """
    first = None
    for where, share in _candidates(prior, here, step):
        with suppress(np.linalg.LinAlgError):  # so far off that not even its weights exist
            yield at(where, fixed), where, share
            first = first or where
    if first is not None:
        with suppress(np.linalg.LinAlgError, UnobservableError):
            high = at(first, fixed)
            onward = factor(high.system).solve(high.rhs)
            where = next(_candidates(prior, high, onward))[0]
            yield at(where, fixed), where, 1.0


def _next_damping(damping: float, gain: float) -> float:
    """Less damping after a step that kept its promise, more after one that did not (Nielsen 1999).

    Shrinking in proportion to how well the promise was kept avoids refusing every other step.
    """
    if not gain > WORTHWHILE:  # NaN included
        return max(_DAMPING[0], 4.0 * damping)
    shrunk = damping * max(0.2, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
    return 0.0 if shrunk < _DAMPING[0] else shrunk
