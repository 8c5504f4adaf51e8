"""Solve from one start, and from others if it may be astray: static shapes, rest, arcs, pieces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.bent_starts import bent_starts
from glissando.estimation.misfit import is_implausible
from glissando.estimation.other_shapes import PROBABLE
from glissando.estimation.static_starts import wide_bend
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.priors.separable import SeparablePrior
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Solution, SolverOptions
from glissando.solver.outcome import Outcome

_DOUBTFUL = 10.0  # error in standard deviations per unknown up to which a start is trusted
_MOMENTS, _OF_ROD = 8, 28  # most time nodes for which bent shapes are starts; the same for a rod
_ROUGH_ITERATIONS = 30  # from a bent shape
_PATIENCE = 40  # iterations after which a search that is far from any minimum tries other starts
_FAR = 0.05  # distance over the length, beyond which a motion is another
_QUICK = 12  # iterations within which a search from rest is not astray
_FEW = 30  # iterations from static shapes, which usually need half as many
_SUSPECT = 3.0  # times the expected cost, beyond which other starts are tried

Start = tuple[State | None, Sequence[tuple[SensorParameter, Array]]]
"""Nodes to start from, or None for rest, and sensor parameters with their values."""


Solve = Callable[[Start, SolverOptions | None], Solution]
"""Solution from a start, with other options if given; may raise an error."""


@dataclass(frozen=True)
class StartProblem:
    """Estimation problem for which several starts are tried.

    Attributes:
        prior: The prior.
        grid: The nodes.
        readings: Readings to explain.
        options: Stopping criteria.
        piece: Solves for a range of the time nodes from a start; may raise an error.
    """

    prior: Prior
    grid: Grid
    readings: Sequence[Readings]
    options: SolverOptions
    piece: Callable[[slice, State | None], Solution]


_OtherStarts = Callable[[StartProblem, Solution | None, Start, Solve], Solution | None]


def best_end(sought: StartProblem, start: Start, solve: Solve) -> tuple[Solution, str]:
    """Solve from one start, and from others where that start proves far off.

    A search from rest that is not quick starts at static shapes if the robot is widely bent. Other
    starts are rest, and, if the solution does not explain the readings, bent shapes for few time
    nodes, or for many the joined solutions of short pieces, solved one after the other. With few
    iterations allowed no other starts are tried.

    Args:
        sought: The problem.
        start: The first start.
        solve: Solves from a start.

    Returns:
        The best solution, whose iterations are those from all starts, and a sentence on other
        motions if they are probable.

    Raises:
        UnobservableError: All starts break down (or numpy's LinAlgError).
    """
    taken: list[int] = []

    def counted(initial: Start, options: SolverOptions | None) -> Solution:
        solution = solve(initial, options)
        taken.append(solution.iterations)
        return solution

    ends = _from_wide_bend(sought, start, counted) if start[0] is None else []
    end = _finished(sought, ends[0], counted) if ends else _best_end(sought, start, counted)
    return replace(end, iterations=sum(taken)), _other_motions(sought, ends)


def _from_wide_bend(sought: StartProblem, start: Start, solve: Solve) -> list[Solution]:
    """Plausible solutions where the robot is widely bent, likeliest first; none where it is not.

    The only one is that from rest if that is quick; else they are those from static shapes.
    """
    options = sought.options
    if options.max_iterations < _ROUGH_ITERATIONS:
        return []
    bend = wide_bend(sought.prior, sought.grid, sought.readings)
    if bend is None:
        return []

    def plausible(state: State | None, most: int) -> Solution | None:
        with suppress(np.linalg.LinAlgError, UnobservableError):
            end = solve((state, start[1]), replace(options, max_iterations=most))
            return None if is_implausible(sought.prior, end, _SUSPECT) else end
        return None

    quick = plausible(None, _QUICK)
    if quick and quick.outcome.sound and quick.iterations <= _QUICK:
        return [quick]
    ends = [end for state in bend.starts() if (end := plausible(state, _FEW))]
    return sorted(ends, key=log_fit, reverse=True)


def _finished(sought: StartProblem, end: Solution, solve: Solve) -> Solution:
    """The solution, continued if the search ended at its limit of iterations."""
    left = sought.options.max_iterations - _FEW
    if end.outcome is not Outcome.ITERATION_LIMIT or left <= 0:
        return end
    with suppress(np.linalg.LinAlgError, UnobservableError):
        return solve(start_at(end), replace(sought.options, max_iterations=left))
    return end


def _other_motions(sought: StartProblem, ends: Sequence[Solution]) -> str:
    """Sentence on other solutions far from the first, if they are probable; else empty.

    A prior counts a shape that lasts once for every time scale, which exaggerates how much less
    likely it is than another. Of a robot that is still the evidence at one moment is true, so
    differences of evidence are divided by the number of time scales.
    """
    if len(ends) < 2:
        return ""
    time, length = sought.grid.time, float(sought.grid.arclength[-1])
    scale = sought.prior.time_scale if isinstance(sought.prior, SeparablePrior) else np.inf
    counted = max(1.0, float(time[-1] - time[0]) / scale)
    place, odds = ends[0].state.pose[..., :3, 3], 0.0
    farthest: tuple[float, int, int] = 0.0, 0, 0
    for other in ends[1:]:
        away = np.linalg.norm(other.state.pose[..., :3, 3] - place, axis=-1)
        k, n = divmod(int(np.argmax(away)), away.shape[1])
        if away[k, n] > _FAR * length:
            odds += float(np.exp((log_fit(other) - log_fit(ends[0])) / counted))
            farthest = max(farthest, (float(away[k, n]), k, n))
    probability = odds / (1.0 + odds)
    if probability < PROBABLE:
        return ""
    distance, k, n = farthest
    return (
        f"The readings also fit other motions, with a probability of {100.0 * probability:.0f} %, "
        f"up to {distance:.2g} m away at {sought.grid.arclength[n]:.3g} m and "
        f"{seconds(time[k])} s. The covariance describes the neighbourhood of one; a second "
        f"sensor, or one that slides, would decide."
    )


def log_fit(solution: Solution) -> float:
    """Log evidence without the prior's normaliser. Source: equation (22)."""
    return -solution.cost - 0.5 * (solution.equations.log_det_noise + solution.cholesky.log_det)


def _best_end(sought: StartProblem, start: Start, solve: Solve) -> Solution:
    prior, try_others = sought.prior, _other_starts(sought)
    try:
        end, try_others = _solve_with_patience(sought, start, solve, try_others)
    except (np.linalg.LinAlgError, UnobservableError):
        other = try_others(sought, None, start, solve) if try_others else None
        if other is None or _is_suspect(prior, other):
            raise
        return other
    if start[0] is not None and _is_doubtful(end):
        with suppress(np.linalg.LinAlgError, UnobservableError):
            end = max(end, solve((None, start[1]), None), key=partial(_rank, prior))
    if try_others and _is_suspect(prior, end):
        end = try_others(sought, end, start, solve) or end
    return end


def _solve_with_patience(
    sought: StartProblem, start: Start, solve: Solve, try_others: _OtherStarts | None
) -> tuple[Solution, _OtherStarts | None]:
    """Solve from a start; try others if the search is far from any minimum after many iterations.

    Returns:
        The solution, and the function that tries other starts unless it has been called.
    """
    if try_others is None:
        return solve(start, None), None
    prior, options = sought.prior, sought.options
    end = solve(start, replace(options, max_iterations=min(options.max_iterations, _PATIENCE)))
    left = options.max_iterations - _PATIENCE
    if end.outcome is not Outcome.ITERATION_LIMIT or left <= 0:
        return end, try_others
    far = is_implausible(prior, end, _SUSPECT)
    if far and (other := try_others(sought, end, start, solve)) and not _is_suspect(prior, other):
        return other, None
    continued = solve(start_at(end), replace(options, max_iterations=left))
    continued = replace(continued, first_step=end.first_step)
    return max(end, continued, key=partial(_rank, prior)), None if far else try_others


def start_at(solution: Solution) -> Start:
    """Start at a solution."""
    return solution.state, solution.located.parameters.by_name()


def _other_starts(sought: StartProblem) -> _OtherStarts | None:
    """Function that tries other starts, or None where that costs too much, as pieces of a rod."""
    count, rod = sought.grid.time.size, isinstance(sought.prior, MechanicalPrior)
    if sought.options.max_iterations < _ROUGH_ITERATIONS or (rod and count > _OF_ROD):
        return None
    return _from_bent if rod or count <= _MOMENTS else _from_pieces


def _from_bent(
    sought: StartProblem, end: Solution | None, start: Start, solve: Solve
) -> Solution | None:
    """Solve roughly from bent shapes until one is plausible, then fully from the best.

    Returns `end`, which may be None, where no bent shape leads to a better solution.
    """
    prior, grid = sought.prior, sought.grid
    best, worth = end, partial(_rank, prior)
    for bent in bent_starts(prior, grid, sought.readings):
        rough = sought.options.rougher(bent.numbers * grid.time.size)
        with suppress(np.linalg.LinAlgError, UnobservableError):
            rough_end = solve((bent, start[1]), replace(rough, max_iterations=_ROUGH_ITERATIONS))
            best = max(best or rough_end, rough_end, key=worth)
            if not _is_suspect(prior, best):
                break
    if best is None or best is end:
        return end
    with suppress(np.linalg.LinAlgError, UnobservableError):
        best = solve(start_at(best), None)
    return max(end or best, best, key=worth)


def _from_pieces(
    sought: StartProblem, end: Solution | None, start: Start, solve: Solve
) -> Solution | None:
    """Solve pieces of a few time nodes, each started from the one before, then all from these.

    Pieces overlap by half, and nodes near their ends are not used. If a piece is implausible as
    well, other starts do not help, and `end` is returned.
    """
    count, half = sought.grid.time.size, _MOMENTS // 2
    state, last = sought.prior.rest_state(sought.grid), None
    with suppress(np.linalg.LinAlgError, UnobservableError):
        for first in range(0, count - half, half):
            times = slice(first, min(first + _MOMENTS, count))
            part = sought.piece(times, last and _tail_from(last, half, times.stop - first))
            if _is_suspect(sought.prior, part):
                return end
            last, skipped = part.state, half // 2 if first else 0
            for whole, own in zip(state.fields(), last.fields(), strict=True):
                whole[first + skipped : times.stop] = own[skipped:]
        joined = solve((state, start[1]), None)
        return max(end or joined, joined, key=partial(_rank, sought.prior))
    return end


def _tail_from(state: State, begin: int, count: int) -> State:
    """States (`count`, N) from time node `begin` on, the last one repeated as necessary."""
    return state.take(np.minimum(begin + np.arange(count), len(state.pose) - 1))


def _is_suspect(prior: Prior, end: Solution) -> bool:
    """Whether a solution did not converge, or has a cost that suggests a lower minimum."""
    return not end.outcome.sound or is_implausible(prior, end, _SUSPECT)


def _is_doubtful(solution: Solution) -> bool:
    """Whether a solution may not be the lowest minimum, as its start was far off."""
    far = solution.first_step > _DOUBTFUL * float(np.sqrt(solution.equations.rhs.size))
    return far or not solution.outcome.sound


def _rank(prior: Prior, end: Solution) -> tuple[bool, bool, float]:
    """Rank of a solution: a plausible cost first, then convergence, then a low cost.

    Where weights oscillate with the shape, the right shape may be found without convergence, and a
    wrong one converge.
    """
    return not is_implausible(prior, end), end.outcome.sound, -end.cost
