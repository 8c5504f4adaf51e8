"""Factors of readings of the whole robot at one time, such as displacements of tendons."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from glissando._kernels.arrays import whole
from glissando.errors import SensorError
from glissando.geometry.covariance import symmetric_root
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, sort_points
from glissando.model.noise import sqrt_information
from glissando.model.priors.prior import Prior, both_sides
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, STRAIN, State
from glissando.solver.located_readings import LocatedReadings

_PIECES = 4  # least number of pieces of an interval between nodes
_JOINT = 1e-6  # m: nodes no farther apart are the two sides of a joint, without an interval

Parts = list[tuple[Index, Interpolation]]
"""Indices of points, and the interpolated states there."""


def spanning_factor(
    readings: Readings, prior: Prior, located: LocatedReadings, state: State, noise_state: State
) -> Factors:
    """Factors of readings that depend on the whole robot at their time, also between its nodes.

    The error of interpolation in time counts as fully correlated along the robot, which it nearly
    is. The error of interpolation in arclength is taken at a time node; it displaces all poses
    between two nodes to one side.

    Args:
        readings: Readings (M,).
        prior: Prior that interpolates between the nodes.
        located: All readings and their grid.
        state: Nodes (K, N) to linearise at.
        noise_state: Nodes (K, N) from whose rates the interpolation's covariance is computed.

    Raises:
        SensorError: A sensor parameter shifts the readings.
    """
    if located.parameters.of(readings):
        raise SensorError(
            f"{readings.label}: parameters of a sensor that reads the whole robot are not "
            f"estimated; leave them out."
        )
    nodes = both_sides(located.grid.arclength, prior.joints)
    s = _refined(nodes, readings.longest_step)
    every = np.tile(s, len(readings)), np.repeat(readings.time, s.size)
    at, parts = interpolated(prior, located.grid, state, noise_state, *every)
    before = np.searchsorted(located.grid.time, every[1], side="right") - 1
    on_node = every[0], located.grid.time[np.maximum(before, 0)]
    _, on_nodes = interpolated(prior, located.grid, state, noise_state, *on_node)
    at, inner = at.reshape(len(readings), s.size), np.searchsorted(s, nodes)  # places of nodes
    residual, by_state = readings.residual_over(s, at), readings.jacobian_over(s, at)
    nodes_read, by_nodes = _jacobians_by_nodes(parts, by_state, located.grid.arclength.size)
    bridge_cov = _cov_in_time(by_state, _between_nodes(_cov_given_nodes(parts, s.size), s, inner))
    bridge_cov += _cov_in_arclength(
        by_state[..., STRAIN], _cov_given_nodes(on_nodes, s.size)[..., :6, :6], s, inner
    )
    terms = Residuals(residual, sqrt_information(readings.cov + bridge_cov), readings.loss)
    return Factors(nodes_read, slice(0, state.dof), whole(by_nodes.swapaxes(1, 2)), terms)


def _refined(nodes: Array, longest: float) -> Array:
    """Nodes, and places between them that are at most `longest` apart."""
    out = [nodes]
    for begin, end in pairwise(nodes):
        pieces = max(_PIECES, int(np.ceil((end - begin) / longest)))
        if end - begin > _JOINT:
            out.append(begin + (end - begin) * np.arange(1, pieces) / pieces)
    return np.sort(np.concatenate(out))


def _jacobians_by_nodes(parts: Parts, by_state: Array, n_count: int) -> tuple[Index, Array]:
    """Nodes (M, c) that readings depend on, and Jacobians (M, c, r, dof) by them.

    Args:
        parts: Interpolated states at the places of each reading, reading after reading.
        by_state: Jacobians (M, r, places, 18) by the states at the places.
        n_count: Number of arclength nodes.
    """
    (m, rows, places, _), dof = by_state.shape, parts[0][1].dof
    first, last = np.full(m, np.iinfo(np.intp).max), np.zeros(m, dtype=np.intp)
    for at, part in parts:
        time = part.nodes // n_count
        np.minimum.at(first, at // places, time.min(axis=1))
        np.maximum.at(last, at // places, time.max(axis=1))
    nodes = n_count * first[:, None] + np.arange(n_count * (1 + int(np.max(last - first))))
    by_nodes = np.zeros((*nodes.shape, rows, dof))
    for at, part in parts:
        owner, slope = at // places, by_state[at // places, :, at % places]
        through = slope @ part.jacobian.reshape(at.size, DOF, -1)
        through = through.reshape(*slope.shape[:2], -1, dof).swapaxes(1, 2)
        np.add.at(by_nodes, (owner[:, None], part.nodes - nodes[owner, :1]), through)
    return nodes, by_nodes


def _cov_given_nodes(parts: Parts, places: int) -> Array:
    """Covariances (M, P, 18, 18) of interpolation given the nodes, at the places of readings."""
    cov: Array = np.empty((sum(rows.size for rows, _ in parts), DOF, DOF))
    for rows, part in parts:
        cov[rows] = part.cov
    return cov.reshape(-1, places, DOF, DOF)


def _between_nodes(cov: Array, s: Array, nodes: Index) -> Array:
    """Covariances (M, P, 18, 18) at places `s` (P,), linear between those at the nodes."""
    begin = nodes[np.searchsorted(nodes[1:-1], np.arange(s.size), side="right")]
    end = nodes[np.searchsorted(nodes, begin) + 1]
    share = ((s - s[begin]) / (s[end] - s[begin]))[:, None, None]
    return np.asarray(cov[:, begin] * (1.0 - share) + cov[:, end] * share)


def _cov_in_time(by_state: Array, cov: Array) -> Array:
    """Covariances (M, r, r) of readings from interpolation in time.

    Args:
        by_state: Jacobians (M, r, P, 18) by the states at the places.
        cov: Covariances (M, P, 18, 18) of these states given the nodes.
    """
    common = np.sum(by_state.swapaxes(1, 2) @ symmetric_root(cov), axis=1)
    cov_readings: Array = common @ common.swapaxes(1, 2)
    return cov_readings


def _cov_in_arclength(by_strain: Array, cov: Array, s: Array, nodes: Index) -> Array:
    """Covariances (M, r, r) of readings from interpolation in arclength.

    Errors of different intervals are independent. The strain's error is the derivative of the
    pose's, which is zero at the nodes: it cancels where a straight channel continues beyond an
    interval.

    Args:
        by_strain: Jacobians (M, r, P, 6) by the strain at places.
        cov: Covariances (M, P, 6, 6) of the poses there given the nodes, at a time node.
        s: Arclengths (P,) of the places, m.
        nodes: Indices of the nodes among the places.
    """
    steps, root = np.diff(s), symmetric_root(cov)
    weight = by_strain / (0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)))[:, None]
    weight = 0.5 * (weight[:, :, :-1] + weight[:, :, 1:])
    sums = np.add.reduceat(weight.swapaxes(1, 2) @ np.diff(root, axis=1), nodes[:-1], axis=1)
    cov_readings: Array = np.einsum("mkra,mkqa->mrq", sums, sums)
    return cov_readings


def interpolated(
    prior: Prior, grid: Grid, state: State, noise_state: State, arclength: Array, time: Array
) -> tuple[State, Parts]:
    """States at points (M,) of the grid, and the interpolations that yield them.

    Args:
        prior: Prior that interpolates between the nodes.
        grid: The nodes.
        state: Nodes (K, N).
        noise_state: Nodes (K, N) from whose rates the interpolation's covariance is computed.
        arclength: Arclengths (M,) of the points, m.
        time: Times (M,) of the points, s.
    """
    out, parts = State(np.empty((time.size, 4, 4)), *np.empty((2, time.size, 6))), []
    for points in sort_points(grid, arclength, time):
        at = prior.interpolate(grid, state, noise_state, points)
        out.pose[points.rows], out.strain[points.rows] = at.state.pose, at.state.strain
        out.velocity[points.rows] = at.state.velocity
        parts.append((points.rows, at))
    return out, parts
