"""Factors of readings of the whole robot at one time, such as displacements of tendons."""

from __future__ import annotations

import numpy as np

from glissando._kernels.arrays import whole
from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, sort_points
from glissando.model.noise import sqrt_information
from glissando.model.priors.prior import Prior, both_sides
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State
from glissando.solver.located_readings import LocatedReadings

_NOTHING = 1e-300

Parts = list[tuple[Index, Interpolation]]
"""Which of some points, and the states there."""


def spanning_factor(
    readings: Readings, prior: Prior, located: LocatedReadings, state: State, noise_state: State
) -> Factors:
    """Factors of readings that depend on all nodes of their time, and on both sides of joints.

    What the bridge in time leaves open counts as fully correlated along the robot, which it nearly
    is: the careful side. What rows then have in common is that of the same errors everywhere.

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
    s = both_sides(located.grid.arclength, prior.joints)
    every = np.tile(s, len(readings)), np.repeat(readings.time, s.size)
    at, parts = interpolated(prior, located.grid, state, noise_state, *every)
    at = at.reshape(len(readings), s.size)
    residual, by_state = readings.residual_over(s, at), readings.jacobian_over(s, at)
    by_state = by_state.swapaxes(1, 2).reshape(-1, residual.shape[1], DOF)
    nodes, by_nodes, left = _through(parts, by_state, s.size, located.grid.arclength.size)
    terms = Residuals(residual, sqrt_information(readings.cov + left), readings.loss)
    return Factors(nodes, slice(0, state.dof), whole(by_nodes.swapaxes(1, 2)), terms)


def _through(
    parts: Parts, by_state: Array, places: int, n_count: int
) -> tuple[Index, Array, Array]:
    """Nodes (M, c) of readings, slopes (M, c, r, dof) by them, what they leave open (M, r, r).

    Args:
        parts: States at the `places` of each reading, readings after readings.
        by_state: Slopes (M · places, r, 18) by the states there.
        places: How many places a reading depends on.
        n_count: Arclength nodes.
    """
    m, dof = len(by_state) // places, parts[0][1].dof
    first, last = np.full(m, np.iinfo(np.intp).max), np.zeros(m, dtype=np.intp)
    for rows, part in parts:
        time = part.nodes // n_count
        np.minimum.at(first, rows // places, time.min(axis=1))
        np.maximum.at(last, rows // places, time.max(axis=1))
    nodes = n_count * first[:, None] + np.arange(n_count * (1 + int(np.max(last - first))))
    by_nodes = np.zeros((*nodes.shape, by_state.shape[1], dof))
    std, common = np.zeros((m, by_state.shape[1])), np.zeros((m, by_state.shape[1], DOF))
    for rows, part in parts:
        owner, slope = rows // places, by_state[rows]
        through = slope @ part.jacobian.reshape(rows.size, DOF, -1)
        through = through.reshape(*slope.shape[:2], -1, dof).swapaxes(1, 2)
        np.add.at(by_nodes, (owner[:, None], part.nodes - nodes[owner, :1]), through)
        values, vectors = np.linalg.eigh(part.cov)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None] @ vectors.swapaxes(1, 2)
        np.add.at(std, owner, np.linalg.norm(slope @ root, axis=2))
        np.add.at(common, owner, slope @ root)
    share = std / np.maximum(np.linalg.norm(common, axis=2), _NOTHING)
    common *= share[..., None]
    left = common @ common.swapaxes(1, 2)
    np.einsum("mrr->mr", left)[...] = std**2
    return nodes, by_nodes, left


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
