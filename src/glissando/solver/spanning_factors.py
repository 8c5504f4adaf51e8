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

_PIECES = 4  # of an interval between nodes, at least
_JOINT = 1e-6  # m: what lies just before a joint is no interval

Parts = list[tuple[Index, Interpolation]]
"""Which of some points, and the states there."""


def spanning_factor(
    readings: Readings, prior: Prior, located: LocatedReadings, state: State, noise_state: State
) -> Factors:
    """Factors of readings that depend on the whole robot at their time, between its nodes, too.

    What the bridge in time leaves open counts as fully correlated along the robot, which it nearly
    is. That along the robot, as it is at a time node, moves poses to one side between two nodes.

    Args:
        readings: Readings (M,).
        prior: What lies between the nodes.
        located: All readings, whose grid it is.
        state: Nodes (K, N) to linearise at.
        noise_state: Nodes (K, N) whose rates the bridge's noise comes from.

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
    _, still = interpolated(prior, located.grid, state, noise_state, *on_node)
    at, inner = at.reshape(len(readings), s.size), np.searchsorted(s, nodes)  # places of nodes
    residual, by_state = readings.residual_over(s, at), readings.jacobian_over(s, at)
    here, by_nodes = _through(parts, by_state, located.grid.arclength.size)
    left = _in_time(by_state, _between(_open(parts, s.size), s, inner))
    left += _along(by_state[..., STRAIN], _open(still, s.size)[..., :6, :6], s, inner)
    terms = Residuals(residual, sqrt_information(readings.cov + left), readings.loss)
    return Factors(here, slice(0, state.dof), whole(by_nodes.swapaxes(1, 2)), terms)


def _refined(nodes: Array, longest: float) -> Array:
    """Nodes, and places between them no farther apart than that."""
    out = [nodes]
    for begin, end in pairwise(nodes):
        pieces = max(_PIECES, int(np.ceil((end - begin) / longest)))
        if end - begin > _JOINT:
            out.append(begin + (end - begin) * np.arange(1, pieces) / pieces)
    return np.sort(np.concatenate(out))


def _through(parts: Parts, by_state: Array, n_count: int) -> tuple[Index, Array]:
    """Nodes (M, c) of readings, and slopes (M, c, r, dof) by them.

    Args:
        parts: States at the places of each reading, readings after readings.
        by_state: Slopes (M, r, places, 18) by the states there.
        n_count: Arclength nodes.
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


def _open(parts: Parts, places: int) -> Array:
    """What interpolation leaves open of states (M, P, 18, 18) at the places of each reading."""
    cov: Array = np.empty((sum(rows.size for rows, _ in parts), DOF, DOF))
    for rows, part in parts:
        cov[rows] = part.cov
    return cov.reshape(-1, places, DOF, DOF)


def _between(cov: Array, s: Array, nodes: Index) -> Array:
    """Covariances (M, P, 18, 18) at places `s` (P,) on lines between those at the nodes."""
    begin = nodes[np.searchsorted(nodes[1:-1], np.arange(s.size), side="right")]
    end = nodes[np.searchsorted(nodes, begin) + 1]
    share = ((s - s[begin]) / (s[end] - s[begin]))[:, None, None]
    return np.asarray(cov[:, begin] * (1.0 - share) + cov[:, end] * share)


def _in_time(by_state: Array, cov: Array) -> Array:
    """What the bridge in time leaves open (M, r, r), by slopes (M, r, P, 18) at the places."""
    common = np.sum(by_state.swapaxes(1, 2) @ symmetric_root(cov), axis=1)
    left: Array = common @ common.swapaxes(1, 2)
    return left


def _along(by_strain: Array, cov: Array, s: Array, nodes: Index) -> Array:
    """What the bridges between nodes leave open (M, r, r), each an error of its own.

    The strain's error is the slope of the pose's, which is zero at the nodes: where a straight
    channel goes on beyond an interval nothing is open.

    Args:
        by_strain: Slopes (M, r, P, 6) by the strain at places.
        cov: What is open of the poses there (M, P, 6, 6) at a time node: nothing at nodes.
        s: The places (P,), m.
        nodes: Which of them are nodes.
    """
    steps, root = np.diff(s), symmetric_root(cov)
    weight = by_strain / (0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)))[:, None]
    weight = 0.5 * (weight[:, :, :-1] + weight[:, :, 1:])
    sums = np.add.reduceat(weight.swapaxes(1, 2) @ np.diff(root, axis=1), nodes[:-1], axis=1)
    left: Array = np.einsum("mkra,mkqa->mrq", sums, sums)
    return left


def interpolated(
    prior: Prior, grid: Grid, state: State, noise_state: State, arclength: Array, time: Array
) -> tuple[State, Parts]:
    """States at points (M,) of the grid, and how they were found.

    Args:
        prior: What lies between the nodes.
        grid: The nodes.
        state: Nodes (K, N).
        noise_state: Nodes (K, N) whose rates the bridge's noise comes from.
        arclength: Where, m.
        time: When, s.
    """
    out, parts = State(np.empty((time.size, 4, 4)), *np.empty((2, time.size, 6))), []
    for points in sort_points(grid, arclength, time):
        at = prior.interpolate(grid, state, noise_state, points)
        out.pose[points.rows], out.strain[points.rows] = at.state.pose, at.state.strain
        out.velocity[points.rows] = at.state.velocity
        parts.append((points.rows, at))
    return out, parts
