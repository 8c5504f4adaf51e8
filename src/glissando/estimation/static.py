"""Estimation of many independent static shapes of one robot, all in the same arrays.

A static shape has only pose and strain as unknowns, and its factors couple only neighbouring
arclength nodes. Its system is block-tridiagonal in arclength, and a hundred shapes cost little more
than one. Source: equations (2'), (20), (21).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando._kernels.threads import one_thread
from glissando.errors import (
    OutsideGridError,
    UnobservableError,
)
from glissando.estimation.batch_problem import BatchProblem
from glissando.estimation.given import (
    arclength_nodes,
    require_jacobians,
    require_list,
    require_model,
    require_options,
    static_model,
)
from glissando.estimation.misfit import unreachable_readings
from glissando.estimation.other_shapes import PROBABLE, OtherShapes, other_shapes
from glissando.estimation.outliers import CHANCE, distinct_labels, unlikely
from glissando.estimation.posterior import Posterior
from glissando.estimation.solve_report import SolveReport
from glissando.estimation.starting_point import bending_easily, with_convex_losses
from glissando.estimation.static_iteration import Solved, iterate, node_covariances
from glissando.estimation.static_posterior import StaticPosterior, require_whole
from glissando.estimation.static_warnings import warn_of_shapes
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.memory import require_memory
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.priors.static import STATIC_DOF
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.curvature import curvature, with_curvature
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.outcome import Outcome
from glissando.solver.static_equations import linearize_static, static_factors

_DOFS = slice(0, STATIC_DOF)
_BLOCKS = 6.0  # square blocks that are stored for a node of a shape
_SOFT_ITERATIONS = 8
_FEW = 2  # most readings of a shape none of which can be refuted by the others


def estimate_static(
    model: Prior | Robot,
    arclength: ArrayLike,
    readings: Sequence[Readings],
    *,
    count: int | None = None,
    options: SolverOptions | None = None,
) -> StaticPosterior:
    """Posterior of independent static shapes, solved together.

    The estimate of each is that of `estimate` at a single time, whose solver also takes over shapes
    that do not converge here and those with readings that the others may refute. With a mechanical
    prior covariances are from the whole Hessian (31), of which `estimate` omits the curvature.

    Covariances describe the neighbourhood of the shape that is found. Where they leave the
    direction of the body open by more than 0.1 rad, other shapes are sought from shapes drawn from
    the prior: the likeliest becomes the estimate, and a warning names shapes of which others are
    probable. `sample_static` draws from all of them.

    Args:
        model: The robot, whose sensor parameters must be known, or the prior of its shapes.
        arclength: Nodes (N,) of all shapes, metres.
        readings: Readings of each sensor, their `time` the number of the shape.
        count: Number of shapes; if None, one more than the largest number in the readings.
        options: Stopping criteria.

    Raises:
        OutsideGridError: Shapes are not numbered 0, 1, 2, …
        SensorError: A sensor reads a velocity.
        UnobservableError: Prior and readings leave a direction of a shape undetermined.

    Warns:
        NotConvergedWarning: Some shapes did not converge; `outcomes` of the result lists all.
        FalseConfidenceWarning: Many readings contradict some shapes, or other shapes are probable;
            the message names them.

    >>> from glissando import CoilReadings, load_robot
    >>> robot = load_robot("tdcr466")
    >>> tips = np.tile(np.eye(4), (2, 1, 1))
    >>> tips[:, :3, 3] = [[0.05, 0.0, 0.46], [0.0, -0.1, 0.45]]  # two shapes, a reading each
    >>> coil = CoilReadings(time=[0, 1], arclength=[0.466, 0.466], values=tips,
    ...                     cov=[1e-6, 1e-6, 1e-6, 1, 1])
    >>> shapes = estimate_static(robot, robot.arclength_nodes, [coil])
    >>> np.round(shapes.at(0.233, [0, 1]).position, 3) + 0.0
    array([[ 0.012,  0.   ,  0.232],
           [ 0.   , -0.025,  0.231]])
    """
    arclength = arclength_nodes(arclength)
    require_list(readings, Readings, "readings")
    prior, readings = static_model(model, readings)
    require_model(prior, arclength)
    require_jacobians(prior, arclength, readings)
    require_options(options)
    load_kernels(prior, "static_steps")
    given, options = [r for r in readings if len(r)], options or SolverOptions()
    count = _count(given, np.size(arclength), count)
    grid = Grid.apart(arclength, count)
    with one_thread():
        located = locate(grid, given)
        state, (cov, cross), unsolved = _solve_jointly(prior, located, options)
        unsolved |= _contradicted(prior, located, state)
    reports, refused = _solve_remaining(prior, grid, given, options, unsolved, state, cov, cross)
    others = _use_likeliest(prior, grid, given, options, refused, reports, (state, cov, cross))
    warn_of_shapes(reports, others)
    outcomes = tuple(
        reports[k].outcome if k in reports else Outcome.CONVERGED for k in range(count)
    )
    if isinstance(prior, MechanicalPrior):
        with one_thread():
            cov, cross = _with_curvature(prior, located, state, cov, cross)  # (31)
    probability = {each.number: each.probability for each in others}
    return StaticPosterior(prior, grid, state, cov, cross, outcomes, refused, probability)


def _contradicted(prior: Prior, located: LocatedReadings, state: State) -> NDArray[np.bool_]:
    """Mask (S,) of shapes with an unlikely reading without a loss, and others to refute it."""
    count = located.grid.time.size
    out, read = np.zeros(count, dtype=bool), np.zeros(count, dtype=np.intp)
    for stream, rows, batch in measurement_factors(prior, located, state, state):
        own = located.streams[stream].time[rows].astype(np.intp)
        read += np.bincount(own, minlength=count)
        if batch.terms.loss is None:
            out[own[unlikely(batch.terms)]] = True
    return out & (read > _FEW)


def _solve_remaining(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    options: SolverOptions,
    unsolved: NDArray[np.bool_],
    state: State,
    cov: Array,
    cross: Array,
) -> tuple[dict[int, SolveReport], dict[str, list[int]]]:
    """Estimate each shape in `unsolved` by itself, in place; return reports and refused rows."""
    reports, refused = dict[int, SolveReport](), defaultdict[str, list[int]](list)
    for k in np.flatnonzero(unsolved):
        try:
            one = _alone(prior, grid.arclength, readings, int(k), options)
        except UnobservableError as error:
            raise UnobservableError(f"Shape {k}: {error}") from error
        reports[int(k)] = one.solve
        state.pose[k], state.strain[k] = one.state.pose[0], one.state.strain[0]
        cov[k], cross[k] = _node_blocks(one)
        for r, name in zip(readings, distinct_labels(readings), strict=True):
            rows = np.flatnonzero(r.time == k)
            refused[name] += rows[one.solve.refused.get(name, [])].tolist()
    return reports, {name: rows for name, rows in refused.items() if rows}


def _use_likeliest(
    prior: Prior,
    grid: Grid,
    readings: Sequence[Readings],
    options: SolverOptions,
    refused: Mapping[str, Sequence[int]],
    reports: dict[int, SolveReport],
    known: tuple[State, Array, Array],
) -> list[OtherShapes]:
    """Replace shapes, in place, where another one is likelier; return those of which others remain.

    Args:
        prior: Prior of the shapes.
        grid: Arclength nodes and numbers of the shapes.
        readings: All readings.
        options: When to stop.
        refused: Rows of each stream that were not used.
        reports: Reports of shapes estimated alone; those replaced are entered.
        known: Shapes (S, N), and covariances of their nodes and of neighbouring nodes.
    """
    labels, (state, cov, cross) = distinct_labels(readings), known
    used = [
        r.select(np.delete(np.arange(len(r)), refused.get(label, [])))
        for r, label in zip(readings, labels, strict=True)
    ]
    with one_thread():
        others = other_shapes(prior, grid.arclength, used, state, cov)
    for k, start in ((each.number, each.likeliest) for each in others):
        if start is not None:
            start = start.take(np.newaxis)
            one = _alone(prior, grid.arclength, used, k, options, start)
            state.pose[k], state.strain[k] = one.state.pose[0], one.state.strain[0]
            cov[k], cross[k] = _node_blocks(one)
            reports[k] = one.solve
    return [each for each in others if each.probability >= PROBABLE]


def _count(readings: Sequence[Readings], nodes: int, count: int | None) -> int:
    """Number of shapes; checks that their numbers are whole and that they fit into memory."""
    for r in readings:
        require_whole(r.time, r.label)
    if count is not None and (not isinstance(count, int | np.integer) or count < 1):
        raise OutsideGridError(f"count is {count!r}; give how many shapes there are, 1 or more.")
    if count is None:
        count = 1 + int(max((r.time.max() for r in readings), default=0.0))
    require_memory(
        _BLOCKS * 8.0 * STATIC_DOF**2 * nodes * count,
        f"Shapes 0 to {count - 1} would be {count:,} shapes",
        "number the readings' shapes 0, 1, 2, … in place of times",
    )
    return count


def _solve_jointly(prior: Prior, located: LocatedReadings, options: SolverOptions) -> Solved:
    """Solve for all shapes together; where that breaks down, all are marked as not solved.

    Raises:
        SensorError: Readings lie far beyond the robot's reach.
        UnobservableError: Prior and readings leave a direction of a shape undetermined.
    """
    grid = located.grid
    try:
        solved = iterate(prior, located, _first_shapes(prior, located), options)
    except (np.linalg.LinAlgError, UnobservableError) as error:
        _require_reach(prior, located)
        if isinstance(error, UnobservableError):
            raise
    else:
        if np.any(solved[2]):
            _require_reach(prior, located)
        return solved
    (count, nodes), blocks = grid.shape, (STATIC_DOF, STATIC_DOF)
    cov, cross = np.empty((count, nodes, *blocks)), np.empty((count, nodes - 1, *blocks))
    return prior.rest_state(grid), (cov, cross), np.ones(count, dtype=bool)


def _require_reach(prior: Prior, located: LocatedReadings) -> None:
    """Raise SensorError where readings lie far beyond the robot's reach."""
    first = prior.of_shape(0) if isinstance(prior, MechanicalPrior) else prior
    far = unreachable_readings(located.grid, first, located.streams)
    if far is not None:
        raise far


def _first_shapes(prior: Prior, located: LocatedReadings) -> State:
    """Shapes to start from: at rest, or solved from rest with soft shear and convex losses."""
    soft, start = bending_easily(prior, located), prior.rest_state(located.grid)
    convex = with_convex_losses(located)
    if convex is not located:
        return iterate(soft, convex, start, SolverOptions())[0]
    if soft is prior:
        return start
    rough = SolverOptions.rough(located.grid.arclength.size * STATIC_DOF)
    return iterate(soft, located, start, replace(rough, max_iterations=_SOFT_ITERATIONS))[0]


def _alone(
    prior: Prior,
    arclength: Array,
    readings: Sequence[Readings],
    k: int,
    options: SolverOptions,
    start: State | None = None,
) -> Posterior:
    """Estimate of shape k by itself, at a single time, from rest or from a start (1, N)."""
    own = [r.select(r.time == k) for r in readings]
    own = [r.changed(time=np.zeros(len(r))) for r in own]
    if isinstance(prior, MechanicalPrior):
        prior = prior.of_shape(k)
    problem = BatchProblem(prior, Grid(arclength, [0.0]), own, (), options, None, CHANCE)
    return problem.placed((start, ()))


def _node_blocks(one: Posterior) -> tuple[Array, Array]:
    """Covariances (N, 12, 12) of the nodes of a single time, and of neighbours (N−1, 12, 12)."""
    every = np.arange(one.grid.arclength.size)
    whole = one.marginals.cov[0].reshape(every.size, one.state.dof, every.size, -1)
    whole = whole[:, _DOFS, :, _DOFS]
    return whole[every, :, every], whole[every[:-1], :, every[1:]]


def _with_curvature(
    prior: Prior, located: LocatedReadings, state: State, cov: Array, cross: Array
) -> tuple[Array, Array]:
    """Covariances as from `node_covariances`, of the whole Hessian at a state.

    A shape whose Hessian is singular by rounding keeps the given covariances: those of a damped
    Hessian would be too small.
    """
    here = linearize_static(prior, located, state)
    step = here.cholesky.solve(here.rhs.reshape(-1, STATIC_DOF)).reshape(here.rhs.shape)
    std = np.sqrt(np.einsum("snii->sni", cov))
    added = curvature(lambda at: static_factors(prior, located, at), state, step, std)
    whole = replace(here, system=with_curvature(here, added))
    damped, refined = whole.damped, node_covariances(whole, state)
    for new, before in zip(refined, (cov, cross), strict=True):
        new[damped] = before[damped]
    return refined
