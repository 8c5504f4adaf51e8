"""Search along a Gauss–Newton step: straight, bent, shortened, or followed by further steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np

from glissando.errors import UnobservableError
from glissando.geometry.se3 import Array
from glissando.model.priors.prior import Prior
from glissando.model.state import State
from glissando.solver.block_tridiagonal import factor
from glissando.solver.linearize import NormalEquations
from glissando.solver.located_readings import LocatedReadings

WORTHWHILE = 1e-3
"""Share of the predicted fall in cost below which a step is refused."""
ROUNDING = 1e-11
"""Relative fall in cost that cannot be distinguished from rounding."""
_GOOD = 0.25  # share of the predicted fall above which no other candidate is tried
_SHORTER = (0.5, 0.2)  # parts of a refused step that are tried
_WATCHED, _SHRINKING = 6, 0.5  # most steps after a refused one; largest ratio to the one before

Where = tuple[State, LocatedReadings]
"""A state, and the readings located with the sensor parameters that belong to it."""

Linearize = Callable[[Where, NormalEquations | None], NormalEquations]
"""Normal equations at a state, with the weights of other equations if these are given."""


@dataclass(frozen=True)
class _Candidate:
    """A state to try, the share of the predicted fall there, and whether a whole step was bent.

    `bent` is None for a step that is not the whole one.
    """

    where: Where
    share: float = 1.0
    bent: bool | None = None


def candidates(
    prior: Prior, here: NormalEquations, step: Array, *, bent: bool = False
) -> Iterator[_Candidate]:
    """States to try for a step: straight, bent, and bent and shortened; straight last if `bent`.

    A long straight step makes poses inconsistent with strains, which stiff priors penalise; in a
    bent step poses follow from the strains. Along a curved valley a shortened step is better than
    a damped one.
    """
    if not bent:
        yield _Candidate(_straight(here, step), bent=False)
    for part in (1.0, *_SHORTER):
        where = _bent(prior, here, part * step)
        yield _Candidate(where, part * (2.0 - part), True if part == 1.0 else None)
    if bent:
        yield _Candidate(_straight(here, step), bent=False)


def whole_steps(prior: Prior, here: NormalEquations, step: Array) -> Iterator[Where]:
    """Ends of the whole step: straight, then bent."""
    return (way.where for way in islice(candidates(prior, here, step), 2))


def _straight(here: NormalEquations, step: Array) -> Where:
    """End of a step that moves each node independently."""
    of_nodes, of_parameters = here.split(step)
    return here.state.retract(of_nodes), here.located.moved(of_parameters)


def _bent(prior: Prior, here: NormalEquations, step: Array) -> Where:
    """End of a step in which poses follow from the strains."""
    of_nodes, of_parameters = here.split(step)
    located = here.located.moved(of_parameters)
    return prior.retract_strains(located.grid, here.state, of_nodes), located


def try_step(
    prior: Prior,
    here: NormalEquations,
    step: Array,
    fixed: NormalEquations | None,
    predicted: float,
    at: Linearize,
    *,
    bent: bool,
) -> tuple[NormalEquations, float, bool]:
    """Take the first candidate that lowers the cost well, else the best, or stay.

    Args:
        prior: The prior.
        here: The problem where the step begins.
        step: The step (K, D).
        fixed: The problem whose weights are kept, or None.
        predicted: Fall in cost that is predicted for the whole step.
        at: Linearises at a state.
        bent: Whether the last whole step was better bent than straight: bent is tried first.

    Returns:
        The problem there; its gain, the actual over the predicted fall in cost; whether the next
        step is tried bent first.
    """
    cost, best, best_gain = here.cost_of(here), (here.state, here.located), WORTHWHILE
    gain = -1.0
    for stepped, way in _ways(prior, here, step, fixed, at, bent=bent):
        if predicted < ROUNDING * (1.0 + cost):
            return stepped, 1.0, bent
        gain = (cost - here.cost_of(stepped)) / (way.share * predicted)
        if gain > _GOOD:
            return stepped, gain, bent if way.bent is None else way.bent
        if gain > best_gain:
            best, best_gain = way.where, gain
    return at(best, fixed), best_gain if best_gain > WORTHWHILE else gain, bent


def _ways(
    prior: Prior,
    here: NormalEquations,
    step: Array,
    fixed: NormalEquations | None,
    at: Linearize,
    *,
    bent: bool,
) -> Iterator[tuple[NormalEquations, _Candidate]]:
    """The problem at each candidate for which weights exist.

    Last come the ends of further steps from the straight one, while these shrink. A step along
    the tangent of a narrow valley ends high on its side and shorter ones gain little; the steps
    that follow return to the valley farther on (Chamberlain et al., The watchdog technique, 1982).
    """
    for way in candidates(prior, here, step, bent=bent):
        with suppress(np.linalg.LinAlgError):  # too far off for weights to exist
            yield at(way.where, fixed), way
    with suppress(np.linalg.LinAlgError, UnobservableError):
        high, length = at(next(candidates(prior, here, step)).where, fixed), np.inf
        for _ in range(_WATCHED):
            onward = factor(high.system).solve(high.rhs)
            before, length = length, float(np.sqrt(np.sum(onward * high.rhs)))
            if not length < _SHRINKING * before:
                return
            way = _Candidate(next(candidates(prior, high, onward)).where)
            high = at(way.where, fixed)
            yield high, way
