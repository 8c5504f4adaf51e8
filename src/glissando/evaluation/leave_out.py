"""Cross-validation: readings compared with predictions that did not use them.

An innovation leaves out one reading at a time. The readings before and after it from a fast sensor
share its error, so that the prediction follows the error. Here all readings of a stream are left
out at once, for the whole recording or for intervals of time, or the prior alone predicts them.
Source: Gelman et al., Bayesian Data Analysis, chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from glissando.errors import UnobservableError
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.outliers import CHANCE
from glissando.estimation.posterior import Posterior
from glissando.estimation.reading_fit import fit_of
from glissando.evaluation.consistency import Consistency
from glissando.evaluation.effective_samples import effective_errors, effective_samples
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import SolverOptions

_STRETCHES = 8  # intervals of time, every other of which is left out
_CURVED = 0.2  # rad, standard deviation of a cross-section's axis beyond which linearisation fails
_ROWS = 400  # readings of a stream that are predicted

Watch = Callable[[str, int, int], None]
"""Called before each estimate with the name of what is left out, its index, and their number."""


def leave_out(
    robot: Robot, grid: Grid, readings: Sequence[Readings], watch: Watch | None = None
) -> list[Consistency]:
    """Consistency of readings with predictions that did not use them.

    Each stream is predicted from the others ("by the others"), in intervals of time from the
    readings outside them ("by other times"), and from the prior alone ("by the prior"). If the
    readings used leave the robot unobservable, there is no prediction from them.

    Args:
        robot: The robot with its prior and sensor parameters.
        grid: Nodes of the estimates.
        readings: The streams, as `estimate` takes them.
        watch: Called before each estimate: one for each stream if there are several, and three.
    """
    streams = [r.inside(grid) for r in readings if len(r) and r.reads_one_state]
    in_odd_interval = [_stretch(r, grid) for r in streams]
    jobs: list[tuple[str, list[Readings], list[Readings]]] = []
    if len(streams) > 1:
        for k, r in enumerate(streams):
            jobs.append(("by the others", streams[:k] + streams[k + 1 :], [r]))
    for flip in (False, True):
        used = [r.select(o ^ flip) for r, o in zip(streams, in_odd_interval, strict=True)]
        held_out = [r.select(~(o ^ flip)) for r, o in zip(streams, in_odd_interval, strict=True)]
        jobs.append(("by other times", used, held_out))
    jobs.append(("by the prior", [], streams))
    errors: dict[tuple[str, str], list[Array]] = {}
    for number, (quantity, used, held_out) in enumerate(jobs):
        if watch is not None:
            names = (
                ", ".join(r.label for r in held_out) if quantity == "by the others" else "stretches"
            )
            watch(names if quantity != "by the prior" else "all", number, len(jobs))
        for r, white in _predicted(robot, grid, used, held_out):
            errors.setdefault((quantity, r.label), []).append(white)
    return list(_judged(errors, {r.label: r for r in streams}))


def _stretch(r: Readings, grid: Grid) -> np.ndarray:
    """Mask (M,) of the readings in every other interval of time."""
    share = (r.time - grid.time[0]) / (grid.time[-1] - grid.time[0])
    number = np.minimum(np.floor(_STRETCHES * share), _STRETCHES - 1)  # at its end, too
    out: np.ndarray = number.astype(int) % 2 == 0
    return out


def _judged(
    errors: dict[tuple[str, str], list[Array]], streams: dict[str, Readings]
) -> Iterator[Consistency]:
    for (quantity, name), parts in errors.items():
        squares = [np.sum(part**2, axis=1) for part in parts]
        effective = sum(
            min(effective_samples(square), effective_errors(part))
            for square, part in zip(squares, parts, strict=True)
        )
        nees = np.concatenate(squares)
        r = streams[name]
        place = float(np.mean(r.arclength))
        yield Consistency(name, place, quantity, nees, r.row_count, effective)


def _predicted(
    robot: Robot, grid: Grid, used: Sequence[Readings], held_out: Sequence[Readings]
) -> Iterator[tuple[Readings, Array]]:
    """Yield each stream that is left out, and its whitened prediction errors (M, r).

    Sensor parameters are predicted with the states, including those without any reading used.
    Readings whose prediction is too uncertain for linearisation are skipped.
    """
    parameters = robot.sensor_parameters
    used = [r for r in used if len(r)]
    try:
        posterior = estimate_in_passing(
            robot.prior, grid, used, parameters, SolverOptions(), gate=CHANCE, keep_all=True
        )
    except UnobservableError:
        return
    known = [parameter for parameter in parameters if parameter.known]
    for r in held_out:
        if len(r):
            some = evenly_chosen(len(r), _ROWS)
            part = corrected(r.select(some), known)
            part = part.select(~_is_curved(posterior, part))
            if len(part):
                yield r, fit_of(posterior, part, predicted=True).white()


def _is_curved(posterior: Posterior, r: Readings) -> NDArray[np.bool_]:
    """Mask (M,) of the readings whose predicted orientation is too uncertain for a covariance."""
    grid = posterior.grid
    place = np.clip(r.arclength, grid.arclength[0], grid.arclength[-1])
    cov = posterior.at(place, np.clip(r.time, grid.time[0], grid.time[-1])).cov
    return np.asarray(np.sqrt(cov[:, 3, 3] + cov[:, 4, 4]) > _CURVED)
