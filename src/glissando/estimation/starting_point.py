"""Start of an estimate: from rest, by a solution on coarse time nodes.

The first iterations take long steps, which a coarse grid and some of the readings determine as well
as all of them, at a fraction of the cost (nested iteration, as multigrid methods start).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glissando.errors import UnobservableError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Progress, SolverOptions, Stopwatch, minimize
from glissando.solver.located_readings import LocatedReadings, locate

_COARSER = 4  # fine time nodes per coarse one
_NEARER = 0.4  # factor on a rough start's tolerance: one more coarse iteration saves a fine one
_WORTHWHILE = 7  # coarse intervals below which they save nothing


def starting_point(
    prior: Prior, located: LocatedReadings, progress: Progress | None, clock: Stopwatch
) -> tuple[State, LocatedReadings, int]:
    """Start near the estimate, by coarse time nodes and a softer prior where these save time.

    With stiff shear and extension a bend takes many steps along a narrow valley of the cost, so a
    stiff prior starts from the estimate of a softer one.

    Args:
        prior: The prior of the motion.
        located: The readings on the grid of the estimate.
        progress: Called after each iteration.
        clock: Stopwatch of the phases.

    Returns:
        State (K, N), readings with the sensor parameters of that start, and number of iterations.
    """
    state, iterations, soft = prior.rest_state(located.grid), 0, bending_easily(prior, located)
    coarse = _coarsened(located) if state.inertia is None else None  # coarse nodes miss vibration
    if coarse is not None:
        options = SolverOptions.rough(coarse.grid.time.size * state.numbers)
        if not coarse.weighted:
            options = replace(options, tolerance=_NEARER * options.tolerance)
        try:
            rough = minimize(soft, coarse, prior.rest_state(coarse.grid), options, progress, clock)
        except (UnobservableError, np.linalg.LinAlgError):
            pass  # the readings that were left out are needed
        else:
            parameters = rough.located.parameters
            step = parameters.at(located.grid.time) - located.parameters.values
            state = between_shapes(rough.state, coarse.grid.time, located.grid.time)
            return state, located.moved(step), rough.iterations
    convex = with_convex_losses(located)
    if soft is not prior or convex is not located:
        options = SolverOptions.rough(state.pose.shape[0] * state.numbers)
        if convex is not located:
            options = replace(options, tolerance=SolverOptions.tolerance)
        rough = minimize(soft, convex, state, options, progress, clock)
        step = rough.located.parameters.values - located.parameters.values
        state, located, iterations = rough.state, located.moved(step), rough.iterations
    return state, located, iterations


def bending_easily(prior: Prior, located: LocatedReadings) -> Prior:
    """The prior with soft shear, unless all readings resolve the body's axes, as of strain.

    Readings of strain determine the bend in a single step. With a soft prior they leave poses that
    shear instead of bending, which a stiff prior would have to correct in many steps.
    """
    stated = located.streams and all(stream.resolves_axes for stream in located.streams)
    return prior if stated else prior.with_soft_shear()


def with_convex_losses(located: LocatedReadings) -> LocatedReadings:
    """The readings with saturating losses replaced by Huber's; unchanged if there are none.

    A loss that saturates discards all readings that its start does not explain: from rest those of
    a bent robot. Huber's loss with the same threshold leads near the shape first (graduated
    non-convexity).
    """
    if not any(isinstance(r.loss, GemanMcClure) for r in located.streams):
        return located
    streams = [
        r.changed(loss=Huber(r.loss.threshold)) if isinstance(r.loss, GemanMcClure) else r
        for r in located.streams
    ]
    process, values = located.parameters.process, located.parameters.values
    return locate(located.grid, streams, process.each, values, keep_all=True)


def with_parameters(
    located: LocatedReadings, values: Sequence[tuple[SensorParameter, Array]]
) -> LocatedReadings:
    """The readings, located with other values of sensor parameters.

    Args:
        located: The readings.
        values: Parameters, matched by name, with values (K, size).
    """
    process, step = located.parameters.process, np.zeros_like(located.parameters.values)
    known = {parameter.name: value for parameter, value in values}
    for parameter, at in zip(process.each, process.columns, strict=True):
        if parameter.name in known:
            step[:, at] = known[parameter.name] - located.parameters.values[:, at]
    return located.moved(step)


def _coarsened(located: LocatedReadings) -> LocatedReadings | None:
    """Part of the readings on part of the time nodes; None where that saves nothing."""
    time, arclength = located.grid.time, located.grid.arclength
    intervals = (time.size - 1) // _COARSER
    if intervals < _WORTHWHILE:
        return None
    nodes = np.round(np.linspace(0, time.size - 1, intervals + 1)).astype(int)
    return locate(
        Grid(arclength, time[nodes], located.grid.before),
        [_thinned(readings, time) for readings in located.streams],
        located.parameters.process.each,
        located.parameters.values[nodes],
        keep_all=True,
    )


def _thinned(readings: Readings, time: Array) -> Readings:
    """Readings that suffice for coarse time nodes: one or two of a stream per fine time node."""
    every = max(1, 2 * len(readings) * _COARSER // (8 * time.size))
    return readings.select(np.arange(0, len(readings), every))


def between_shapes(state: State, coarse: Array, time: Array) -> State:
    """States (K, N) at other times: poses by Hermite cubics in the tangent space, others linear."""
    lower = np.clip(np.searchsorted(coarse, time, side="right") - 1, 0, coarse.size - 2)
    step = (coarse[lower + 1] - coarse[lower])[:, None, None]
    u = ((time - coarse[lower]) / step[:, 0, 0])[:, None, None]
    start, end = state.take(lower), state.take(lower + 1)
    apart = se3.log(se3.inverse(start.pose) @ end.pose)
    first, last = step * start.velocity, step * end.velocity
    last = np.einsum("knij,knj->kni", se3.right_jacobian_inverse(apart), last)
    bend = (3 * u**2 - 2 * u**3) * apart + (u - 2 * u**2 + u**3) * first + (u**3 - u**2) * last
    others = zip(start.fields()[1:], end.fields()[1:], strict=True)
    return State(start.pose @ se3.exp(bend), *((1 - u) * a + u * b for a, b in others))
