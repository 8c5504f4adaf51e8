"""Where a Gauss–Newton step leads: straight on, bent, shorter, or on from the side of a valley."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

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
_PLAIN, _FARTHEST = 2.0, 8.0  # a stretch of a step below which it is as good; and the longest

Where = tuple[State, LocatedReadings]
"""A state, and the readings where the sensor parameters that go with it put them."""

Linearize = Callable[[Where, NormalEquations | None], NormalEquations]
"""The normal equations somewhere, with the weights of others if they are given."""


@dataclass
class Manner:
    """How the last step was taken, which is how the next is tried first.

    Attributes:
        stretch: How many Gauss–Newton steps away the least cost seemed to lie.
        bent: Whether a whole step was better bent than straight on.
    """

    stretch: float = 1.0
    bent: bool = False


@dataclass(frozen=True)
class _Way:
    """Where a step may lead: the share of its promise, and whether a whole step is bent or not."""

    where: Where
    share: float = 1.0
    bent: bool | None = None


def candidates(
    prior: Prior, here: NormalEquations, step: Array, *, bent: bool = False
) -> Iterator[_Way]:
    """Where a step may lead: straight on, bent, and bent and shorter; straight on last if `bent`.

    A long step straight on tears poses and strains apart, which stiff priors punish; bent, poses
    still follow from the strains. Along a curved valley a shorter one is better than a damped one.
    """
    if not bent:
        yield _Way(_straight(here, step), bent=False)
    for part in (1.0, *_SHORTER):
        where = _bent(prior, here, part * step)
        yield _Way(where, part * (2.0 - part), True if part == 1.0 else None)
    if bent:
        yield _Way(_straight(here, step), bent=False)


def _straight(here: NormalEquations, step: Array) -> Where:
    """Where a step leads that moves each node by itself."""
    of_nodes, of_parameters = here.split(step)
    return here.state.retract(of_nodes), here.located.moved(of_parameters)


def _bent(prior: Prior, here: NormalEquations, step: Array) -> Where:
    """Where a step leads on which poses follow from the strains."""
    of_nodes, of_parameters = here.split(step)
    located = here.located.moved(of_parameters)
    return prior.bent(located.grid, here.state, of_nodes), located


def try_step(
    prior: Prior,
    here: NormalEquations,
    step: Array,
    fixed: NormalEquations | None,
    predicted: float,
    at: Linearize,
    manner: Manner,
) -> tuple[NormalEquations, float]:
    """The problem at the first way worth it, else as it was; the share of the promise.

    Where steps keep more than they promise, the cost curves less than residuals without their
    second derivatives say, and a stretched step is tried first. The manner becomes that of this.
    """
    cost, best, best_gain = here.cost_of(here), (here.state, here.located), WORTHWHILE
    stretch, manner.stretch = manner.stretch, 1.0
    if stretch > 1.0 and predicted > ROUNDING * (1.0 + cost):
        far = stretch * step
        with suppress(np.linalg.LinAlgError):
            where = _bent(prior, here, far) if manner.bent else _straight(here, far)
            stepped = at(where, fixed)
            gain = (cost - here.cost_of(stepped)) / predicted
            if gain > _PLAIN:
                manner.stretch = _next_stretch(stretch, gain)
                return stepped, gain
    gain = -1.0
    for stepped, way in _ways(prior, here, step, fixed, at, bent=manner.bent):
        if predicted < ROUNDING * (1.0 + cost):
            return stepped, 1.0
        gain = (cost - here.cost_of(stepped)) / (way.share * predicted)
        if gain > _GOOD:
            manner.stretch = _next_stretch(1.0, gain) if stretch == 1.0 else 1.0
            manner.bent = manner.bent if way.bent is None else way.bent
            return stepped, gain
        if gain > best_gain:
            best, best_gain = way.where, gain
    return at(best, fixed), best_gain if best_gain > WORTHWHILE else gain


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
    at: Linearize,
    *,
    bent: bool,
) -> Iterator[tuple[NormalEquations, _Way]]:
    """The problem where each candidate leads, as far as its weights exist.

    Last comes where a second step from straight on leads. A step along the tangent of a narrow
    valley ends high on its side and shorter ones gain little; the next step from there falls back
    into the valley, farther on (Chamberlain et al., The watchdog technique, 1982).
    """
    for way in candidates(prior, here, step, bent=bent):
        with suppress(np.linalg.LinAlgError):  # so far off that not even its weights exist
            yield at(way.where, fixed), way
    with suppress(np.linalg.LinAlgError, UnobservableError):
        high = at(next(candidates(prior, here, step)).where, fixed)
        onward = factor(high.system).solve(high.rhs)
        way = _Way(next(candidates(prior, high, onward)).where)
        yield at(way.where, fixed), way
