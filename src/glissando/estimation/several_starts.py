"""A search from one start, and from others where that ends astray: rest, bent shapes, pieces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.bent_starts import bent_starts
from glissando.estimation.misfit import is_implausible
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Solution, SolverOptions
from glissando.solver.outcome import Outcome

_DOUBTFUL = 10.0  # standard deviations a number by which a start may be off and still be trusted
_MOMENTS, _OF_ROD = 8, 28  # time nodes over which one shape is a start for all; of a rod are tried
_ROUGH_ITERATIONS = 30  # from a bent shape
_PATIENCE = 40  # iterations after which a search that is far from any minimum is left for others
_SUSPECT = 3.0  # times the cost that is expected, beyond which other starts are tried

Start = tuple[State | None, Sequence[tuple[SensorParameter, Array]]]
"""Nodes to start from, rest if there are none, and sensor parameters with their values."""


Solve = Callable[[Start, SolverOptions | None], Solution]
"""Where the iteration ends from a start, with other options if there are any; may break down."""


@dataclass(frozen=True)
class StartProblem:
    """What is estimated.

    Attributes:
        prior: The prior.
        grid: The nodes.
        readings: Readings to explain.
        options: When to stop.
        piece: Where the iteration of some of the time nodes ends from a start; may break down.
    """

    prior: Prior
    grid: Grid
    readings: Sequence[Readings]
    options: SolverOptions
    piece: Callable[[slice, State | None], Solution]


_Elsewhere = Callable[[StartProblem, Solution | None, Start, Solve], Solution | None]


def best_end(sought: StartProblem, start: Start, solve: Solve) -> Solution:
    """Solve from a start, and from others as well where that turns out to be far off.

    Those are rest and, of a few moments that it does not explain, bent shapes; of more, what pieces
    of a few moments lead to, one after the other.

    Args:
        sought: What is estimated.
        start: Where to start.
        solve: Solves from a start.

    Returns:
        The best end; its iterations are those from all starts.

    Raises:
        UnobservableError: All starts break down (or numpy's LinAlgError).
    """
    taken: list[int] = []

    def counted(initial: Start, options: SolverOptions | None) -> Solution:
        solution = solve(initial, options)
        taken.append(solution.iterations)
        return solution

    end = _best_end(sought, start, counted)
    return replace(end, iterations=sum(taken))


def _best_end(sought: StartProblem, start: Start, solve: Solve) -> Solution:
    prior, elsewhere = sought.prior, _elsewhere(sought)
    try:
        end, elsewhere = _patient(sought, start, solve, elsewhere)
    except (np.linalg.LinAlgError, UnobservableError):
        other = elsewhere(sought, None, start, solve) if elsewhere else None
        if other is None or _is_astray(prior, other):
            raise
        return other
    if start[0] is not None and _is_doubtful(end):
        with suppress(np.linalg.LinAlgError, UnobservableError):
            end = max(end, solve((None, start[1]), None), key=partial(_worth, prior))
    if elsewhere and _is_astray(prior, end):
        end = elsewhere(sought, end, start, solve) or end
    return end


def _patient(
    sought: StartProblem, start: Start, solve: Solve, elsewhere: _Elsewhere | None
) -> tuple[Solution, _Elsewhere | None]:
    """Where a search ends, or others if it is still far from any minimum after long.

    Also how to start elsewhere, if that is not done yet.
    """
    if elsewhere is None:
        return solve(start, None), None
    prior, options = sought.prior, sought.options
    end = solve(start, replace(options, max_iterations=min(options.max_iterations, _PATIENCE)))
    left = options.max_iterations - _PATIENCE
    if end.outcome is not Outcome.ITERATION_LIMIT or left <= 0:
        return end, elsewhere
    far = is_implausible(prior, end, _SUSPECT)
    if far and (other := elsewhere(sought, end, start, solve)) and not _is_astray(prior, other):
        return other, None
    onward = solve(start_at(end), replace(options, max_iterations=left))
    onward = replace(onward, first_step=end.first_step)
    return max(end, onward, key=partial(_worth, prior)), None if far else elsewhere


def start_at(solution: Solution) -> Start:
    """Where a solution ended, to start from."""
    return solution.state, solution.located.parameters.by_name()


def _elsewhere(sought: StartProblem) -> _Elsewhere | None:
    """How to start elsewhere, if that is worth it; pieces of a rod's motion cost too much."""
    count, rod = sought.grid.time.size, isinstance(sought.prior, MechanicalPrior)
    if sought.options.max_iterations < _ROUGH_ITERATIONS or (rod and count > _OF_ROD):
        return None
    return _from_bent if rod or count <= _MOMENTS else _from_pieces


def _from_bent(
    sought: StartProblem, end: Solution | None, start: Start, solve: Solve
) -> Solution | None:
    """Solve roughly from bent shapes until one will do, and on from the best if it is better.

    None where all break down, as the start did if there is no `end`.
    """
    prior, grid = sought.prior, sought.grid
    best, worth = end, partial(_worth, prior)
    for bent in bent_starts(prior, grid, sought.readings):
        rough = sought.options.rougher(bent.numbers * grid.time.size)
        with suppress(np.linalg.LinAlgError, UnobservableError):
            rough_end = solve((bent, start[1]), replace(rough, max_iterations=_ROUGH_ITERATIONS))
            best = max(best or rough_end, rough_end, key=worth)
            if not _is_astray(prior, best):
                break
    if best is None or best is end:
        return end
    with suppress(np.linalg.LinAlgError, UnobservableError):
        best = solve(start_at(best), None)
    return max(end or best, best, key=worth)


def _from_pieces(
    sought: StartProblem, end: Solution | None, start: Start, solve: Solve
) -> Solution | None:
    """Solve from estimates of a few moments, each from where the one before leads.

    They overlap by halves, and of each what is not near its ends counts. Where one is not explained
    either, other starts are no cure, and `end` stays.
    """
    count, half = sought.grid.time.size, _MOMENTS // 2
    state, last = sought.prior.rest_state(sought.grid), None
    with suppress(np.linalg.LinAlgError, UnobservableError):
        for first in range(0, count - half, half):
            times = slice(first, min(first + _MOMENTS, count))
            part = sought.piece(times, last and _onward(last, half, times.stop - first))
            if _is_astray(sought.prior, part):
                return end
            last, skipped = part.state, half // 2 if first else 0
            for whole, own in zip(state.fields(), last.fields(), strict=True):
                whole[first + skipped : times.stop] = own[skipped:]
        joined = solve((state, start[1]), None)
        return max(end or joined, joined, key=partial(_worth, sought.prior))
    return end


def _onward(state: State, begin: int, count: int) -> State:
    """States (K, N) from time node `begin` on, the last one held, `count` in all."""
    return state.take(np.minimum(begin + np.arange(count), len(state.pose) - 1))


def _is_astray(prior: Prior, end: Solution) -> bool:
    """Whether an iteration found no minimum, or one that may not be the lowest."""
    return not end.outcome.sound or is_implausible(prior, end, _SUSPECT)


def _is_doubtful(solution: Solution) -> bool:
    """Whether a solution may not be the lowest minimum, as its start was so far off."""
    far = solution.first_step > _DOUBTFUL * float(np.sqrt(solution.equations.rhs.size))
    return far or not solution.outcome.sound


def _worth(prior: Prior, end: Solution) -> tuple[bool, bool, float]:
    """How good the end of an iteration is: whether chance allows its cost, before all.

    Where weights go to and fro with the shape, the right shape may be found and not converge, and a
    wrong one converge.
    """
    return not is_implausible(prior, end), end.outcome.sound, -end.cost
