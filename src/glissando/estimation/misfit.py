"""What readings say against an estimate that used them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import chdtri

from glissando.errors import SensorError, UnobservableError
from glissando.estimation.outliers import Mask
from glissando.model.factors import Residuals
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import Solution

_FAR = 3.0  # lengths of the robot: readings beyond are said to be why equations break down
_MISFIT = 5.0  # standard deviations by which a reading differs from all estimates but a false one
_NAMED = 3  # readings or streams that are named
_CHANCE = 1e-3  # that a residual is beyond what counts as far
_FEWEST = 20  # readings of a stream, for a share of them to say something
_SHARE = 0.1  # of a stream that may be far off
_ALIKE = 0.5  # cosine of residuals, side by side, above which they are no outliers of their own


def worst_readings(solution: Solution) -> str:
    """A sentence on the worst reading of each stream that is beyond what chance allows, or none."""
    misfits = []
    for stream, terms in _terms(solution):
        squared = np.sum(terms.whiten(terms.residual) ** 2, axis=1)
        row = int(np.argmax(squared))
        if squared[row] > _MISFIT**2:
            size = float(np.sqrt(squared[row]))
            misfits.append((size, f"{stream.label} at {seconds(stream.time[row])} s"))
    named = [f"{name} ({size:.3g} standard deviations)" for size, name in sorted(misfits)[::-1]]
    return f"Readings that do not fit: {', '.join(named[:_NAMED])}." if named else ""


def doubt(solution: Solution) -> str:
    """A sentence on streams that mostly contradict the estimate, or none.

    Readings follow an estimate more closely than they scatter about the truth, so where many do
    not, prior or noise exclude what the robot did, and covariances are too small. An impact is none
    of that, nor are outliers that a robust loss forgives: those differ from their neighbours.
    """
    far = []
    for stream, terms in _terms(solution):
        share = float(np.mean(_far_off(terms)))
        if len(stream) >= _FEWEST and share > _SHARE:
            far.append((share, f"{100.0 * share:.0f} % of {stream.label}"))
    if not far:
        return ""
    named = ", ".join(name for _, name in sorted(far)[::-1][:_NAMED])
    return (
        f"The estimate contradicts its readings, so its confidence is too small: {named} lie "
        f"farther from it than one in a thousand should. The prior (stretch, bends, rest shape, "
        f"time scale), mounts, units or noise are not those of this robot."
    )


def _far_off(terms: Residuals) -> Mask:
    """Which residuals (M,) are beyond chance; with a robust loss, and like one beside it."""
    white = terms.whiten(terms.residual)
    size = np.linalg.norm(white, axis=1)
    far: Mask = size**2 > chdtri(white.shape[1], _CHANCE)
    if terms.loss is None:
        return far
    along = np.einsum("mi,mi->m", white[1:], white[:-1])
    alike = far[1:] & far[:-1] & (along > _ALIKE * size[1:] * size[:-1])
    return np.append(alike, False) | np.append(False, alike)


def breakdown(
    error: Exception, grid: Grid, prior: Prior, readings: Sequence[Readings]
) -> Exception:
    """What to raise where equations break down: that readings are far off, or what is undetermined.

    Args:
        error: What the solver raised.
        grid: The nodes.
        prior: The prior.
        readings: The readings that were to be explained.
    """
    far = far_off(grid, prior, readings)
    if far is None and isinstance(error, UnobservableError):
        return error
    return far or SensorError("No shape of this robot comes near the readings.")


def far_off(grid: Grid, prior: Prior, readings: Sequence[Readings]) -> SensorError | None:
    """What to say where equations break down since readings are far beyond the robot's reach."""
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
    said = (
        f"No shape of this robot of {grid.arclength[-1]:g} m comes near the readings: {where}. "
        f"Check units (mm for m, degrees for radians) and frames."
    )
    return SensorError(said) if where else None


def _terms(solution: Solution) -> Iterator[tuple[Readings, Residuals]]:
    """Each stream that has readings, and its terms."""
    every = solution.equations.reading_terms()
    yield from ((r, own) for r, own in zip(solution.located.streams, every, strict=True) if len(r))
