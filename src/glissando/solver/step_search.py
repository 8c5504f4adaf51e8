"""Where a Gauss–Newton step leads: straight on, bent, shorter, or on from the side of a valley."""

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
"""A fall in cost this small, relatively, cannot be told from rounding."""
_GOOD = 0.25  # share above which no other way to take the step is tried
_SHORTER = (0.5, 0.2)  # parts of a refused step that are tried
_WATCHED, _SHRINKING = 6, 0.5  # steps beyond a refused one, each such a part of the one before

Where = tuple[State, LocatedReadings]
"""A state, and the readings where the sensor parameters that go with it put them."""

Linearize = Callable[[Where, NormalEquations | None], NormalEquations]
"""The normal equations somewhere, with the weights of others if they are given."""


@dataclass(frozen=True)
class _Candidate:
    """Where a step may lead: the share of its promise, and whether a whole step is bent or not."""

    where: Where
    share: float = 1.0
    bent: bool | None = None


def candidates(
    prior: Prior, here: NormalEquations, step: Array, *, bent: bool = False
) -> Iterator[_Candidate]:
    """Where a step may lead: straight on, bent, and bent and shorter; straight on last if `bent`.

    A long step straight on tears poses and strains apart, which stiff priors punish; bent, poses
    still follow from the strains. Along a curved valley a shorter one is better than a damped one.
    """
    if not bent:
        yield _Candidate(_straight(here, step), bent=False)
    for part in (1.0, *_SHORTER):
        where = _bent(prior, here, part * step)
        yield _Candidate(where, part * (2.0 - part), True if part == 1.0 else None)
    if bent:
        yield _Candidate(_straight(here, step), bent=False)


def whole_steps(prior: Prior, here: NormalEquations, step: Array) -> Iterator[Where]:
    """Where the whole step leads: straight on, then bent."""
    return (way.where for way in islice(candidates(prior, here, step), 2))


def _straight(here: NormalEquations, step: Array) -> Where:
    """Where a step leads that moves each node by itself."""
    of_nodes, of_parameters = here.split(step)
    return here.state.retract(of_nodes), here.located.moved(of_parameters)


def _bent(prior: Prior, here: NormalEquations, step: Array) -> Where:
    """Where a step leads on which poses follow from the strains."""
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
    """The first way that is worth it, else the best, or none.

    Args:
        prior: The prior.
        here: The problem where the step begins.
        step: The step (K, D).
        fixed: The problem whose weights are kept, if they are.
        predicted: The fall in cost that the whole step promises.
        at: Linearises.
        bent: Whether the last whole step was better bent than straight on: this one is tried so
            first.

    Returns:
        The problem there; its share of the promise; whether the next is tried bent first.
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
    """The problem where each candidate leads, as far as its weights exist.

    Last come the places where further steps from straight on lead, while they shrink. A step along
    the tangent of a narrow valley ends high on its side and shorter ones gain little; those that
    follow fall back into the valley, farther on (Chamberlain et al., The watchdog technique,
    1982).
    """
    for way in candidates(prior, here, step, bent=bent):
        with suppress(np.linalg.LinAlgError):  # so far off that not even its weights exist
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
