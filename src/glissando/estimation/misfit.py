"""Contradictions between an estimate and the readings that it used."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtrc, chdtri

from glissando.errors import OutsideGridError, UnobservableError, UnreachableError
from glissando.estimation.outliers import Mask
from glissando.model.factors import Residuals
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import Solution

_FAR = 3.0  # lengths of the robot: readings farther away explain a breakdown of the equations
_CLOSE = 0.02  # share of the median step: time nodes this close explain a breakdown
_MISFIT = 5.0  # standard deviations of a residual beyond which a reading is named
_NAMED = 3  # most readings or streams that are named
_CHANCE, _RARE = 1e-3, 1e-6  # probabilities of residuals that are far off, and very far off
_SHARE = 0.1  # share of a stream that may be far off
_SURE = 1e-4  # probability of so many that are far off, below which it is not chance
_UNLIKELY, _EXCESS = 1e-4, 6.0  # probability of a cost, and ratio to its expectation, for doubt
_ALIKE = 0.5  # cosine of neighbouring residuals above which they are not separate outliers


def worst_readings(solution: Solution) -> str:
    """Sentence on the worst reading of each stream, if beyond chance; else an empty string."""
    misfits = []
    for stream, terms in _terms(solution):
        squared = np.sum(terms.whiten(terms.residual) ** 2, axis=1)
        row = int(np.argmax(squared))
        if squared[row] > _MISFIT**2:
            size = float(np.sqrt(squared[row]))
            misfits.append((size, f"{stream.label} at {seconds(stream.time[row])} s"))
    named = [f"{name} ({size:.3g} standard deviations)" for size, name in sorted(misfits)[::-1]]
    return f"Readings that do not fit: {', '.join(named[:_NAMED])}." if named else ""


def implausible(
    prior: Prior, cost: ArrayLike, count: ArrayLike, excess: float = _EXCESS
) -> NDArray[np.bool_]:
    """Whether costs of prior and readings are more than chance allows, and far above expectation.

    Twice the least cost is a χ² of as many degrees of freedom as there are scalar readings. In a
    local minimum the cost of the prior is large even if that of the readings is not. The result is
    False for a mechanical prior, as a contact, which `scan_contacts` detects, costs as much.

    Args:
        prior: The prior.
        cost: Half the sum of all squares (…).
        count: Number of scalar readings (…).
        excess: Ratio to the expected cost that is too large.
    """
    bound = np.maximum(chdtri(count, _UNLIKELY), excess * np.asarray(count))
    return np.asarray(2.0 * np.asarray(cost) > bound) & (not isinstance(prior, MechanicalPrior))


def is_implausible(prior: Prior, solution: Solution, excess: float = _EXCESS) -> bool:
    """Whether an estimate's cost is `implausible`, without readings that a loss downweights."""
    cost, count = solution.cost, 0
    for _, terms in _terms(solution):
        counted = terms.robust_weights() > 0.5
        count += int(counted.sum()) * terms.residual.shape[1]
        if terms.loss is not None:
            size = np.linalg.norm(terms.whiten(terms.residual)[~counted], axis=1)
            cost -= float(np.sum(terms.loss.cost(size)))
    return bool(implausible(prior, cost, count, excess))


def misfit_sentence(prior: Prior, solution: Solution) -> str:
    """Sentence on streams that contradict the estimate, or on its cost; else an empty string.

    Readings are closer to an estimate than to the truth, so where many are not, prior or noise
    exclude what the robot did, and covariances are too small. Impacts do not count, nor do outliers
    that a robust loss downweights, which differ from their neighbours.
    """
    far = [
        (share, f"{100.0 * share:.0f} % of {stream.label}")
        for stream, terms in _terms(solution)
        if (share := _contradicting(terms)) > _SHARE
    ]
    if not far and is_implausible(prior, solution):
        return (
            "The estimate contradicts prior and readings together more than chance allows, so its "
            "confidence is too small: another shape may fit better, start nearer to it (initial or "
            "--start), or the prior, mounts, units or noise are not those of this robot."
        )
    if not far:
        return ""
    named = ", ".join(name for _, name in sorted(far)[::-1][:_NAMED])
    why = "The prior (stretch, bends, rest shape, time scale)"
    if isinstance(prior, MechanicalPrior):
        why = "Something touches the robot (see scan_contacts), or its stiffness, rest, weight"
    return (
        f"The estimate contradicts its readings, so its confidence is too small: {named} lie "
        f"farther from it than one in a thousand should. {why}, mounts, units or noise are not "
        f"those of this robot."
    )


def _contradicting(terms: Residuals) -> float:
    """Share of residuals (M,) that are far off, if so many are not by chance; else 0.

    Of fewer than ten one that is very far off suffices.
    """
    for chance in (_CHANCE, _RARE):
        off = _far_off(terms, chance)
        if bdtrc(int(off.sum()) - 1, off.size, chance) < _SURE:
            return float(off.mean())
    return 0.0


def _far_off(terms: Residuals, chance: float) -> Mask:
    """Mask (M,) of residuals less likely than `chance`; with a loss, only if like a neighbour."""
    white = terms.whiten(terms.residual)
    size = np.linalg.norm(white, axis=1)
    far: Mask = size**2 > chdtri(white.shape[1], chance)
    if terms.loss is None:
        return far
    along = np.einsum("mi,mi->m", white[1:], white[:-1])
    alike = far[1:] & far[:-1] & (along > _ALIKE * size[1:] * size[:-1])
    return np.append(alike, False) | np.append(False, alike)


def breakdown(
    error: Exception, grid: Grid, prior: Prior, readings: Sequence[Readings]
) -> Exception:
    """Error to raise where equations break down: readings are far off, or a state undetermined.

    Args:
        error: Error that the solver raised.
        grid: The nodes.
        prior: The prior.
        readings: The readings that were to be explained.
    """
    far = unreachable_readings(grid, prior, readings)
    if far is None and isinstance(error, UnobservableError):
        return _too_close(grid) or error
    named = ", ".join(r.label for r in readings[:_NAMED])
    return far or UnreachableError(
        f"No shape of this robot comes near the readings ({named}). Check units (mm for m, degrees "
        f"for radians), frames and the robot's length."
    )


def _too_close(grid: Grid) -> OutsideGridError | None:
    """Error for two time nodes so close that information loses its digits, or None."""
    steps = np.diff(grid.time)
    if not steps.size or steps.min() > _CLOSE * np.median(steps):
        return None
    k = int(np.argmin(steps))
    return OutsideGridError(
        f"The time nodes {k} and {k + 1} at {seconds(grid.time[k])} s are {steps[k]:.2g} s apart, "
        f"others {np.median(steps):.2g} s: too close for information to keep its digits; leave one."
    )


def unreachable_readings(
    grid: Grid, prior: Prior, readings: Sequence[Readings]
) -> UnreachableError | None:
    """Error for readings far beyond the robot's reach, or None if there are none."""
    base = prior.rest_state(Grid(grid.arclength, grid.time[:1])).pose[0, 0, :3, 3]
    farthest, where = _FAR * float(grid.arclength[-1]), ""
    for r in readings:
        if r.value_shape in ((4, 4), (3,)) and r.fixes_base and len(r):
            place = r.values[:, :3, 3] if r.value_shape == (4, 4) else r.values
            away = np.linalg.norm(place - base, axis=1)
            if away.max() > farthest:
                row = int(np.argmax(away))
                farthest, at = float(away[row]), seconds(r.time[row])
                where = f"{r.label} row {row} at {at} s, {farthest:.3g} m from the base"
    message = (
        f"No shape of this robot of {grid.arclength[-1]:g} m comes near the readings: {where}. "
        f"Check units (mm for m, degrees for radians) and frames."
    )
    return UnreachableError(message) if where else None


def _terms(solution: Solution) -> Iterator[tuple[Readings, Residuals]]:
    """Each stream that has readings, and its residuals."""
    every = solution.equations.reading_terms()
    yield from ((r, own) for r, own in zip(solution.located.streams, every, strict=True) if len(r))
