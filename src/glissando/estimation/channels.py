"""Sensors that slide in a channel beside the backbone, located by the estimated shape.

The arclength of their readings is a travel along the channel, whose length depends on the strain
from the base onwards: dσ/ds = |ν + u × r + dr/ds|. Where the travel is longer than the channel
the sensor sticks out of it in a straight line. Source: (M8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from glissando.errors import SensorError
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior, both_sides
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.tendons import up_to
from glissando.model.state import State
from glissando.model.tendons.channel import Channel
from glissando.model.tendons.travel import channel_lengths, hat_functions
from glissando.solver.measurement_factors import states_at

_ROUNDS = 8
_CLOSE = 2e-5  # share of the length by which readings may still move in their channels
_NUDGE = 1e-6  # m, for a finite difference
_CHUNK = 200  # readings at a time, to bound memory


def place_in_channel(readings: Readings, prior: Prior, grid: Grid, state: State) -> Readings:
    """Convert readings of a sensor in a channel to those of one mounted on the backbone.

    Arclengths become those of the backbone, and the mount that of a sensor which points along the
    channel; `beside` holds the derivatives of the arclengths by the strain at the nodes.

    Args:
        readings: Readings (M,); those of a sensor without a channel are returned unchanged.
        prior: Prior that interpolates between the nodes.
        grid: The nodes.
        state: Nodes (K, N) of the shape.
    """
    channel = readings.channel
    if channel is None:
        return readings
    count, nodes = len(readings), grid.arclength
    where, out = np.empty((2, count))
    beside = np.empty((count, 2, nodes.size, 6))
    places = np.union1d(both_sides(nodes, prior.joints), 0.5 * (nodes[1:] + nodes[:-1]))
    time = np.clip(readings.time, grid.time[0], grid.time[-1])
    for first in range(0, count, _CHUNK):
        rows = slice(first, first + _CHUNK)
        points = np.tile(places, time[rows].size), np.repeat(time[rows], places.size)
        bent = states_at(prior, grid, state, *points).strain.reshape(-1, places.size, 6)
        travel = readings.arclength[rows]
        where[rows], out[rows], beside[rows, 0] = _positions(channel, travel, places, bent, nodes)
        beside[rows, 1] = bent[:, np.searchsorted(places, nodes)]
    # of the straight rod: a mount that followed the estimated twist would confirm it
    mount = channel.frame(where, np.tile(STRAIGHT, (count, 1)))
    nearby = channel.frame(where + _NUDGE, np.tile(STRAIGHT, (count, 1)))
    winding = se3.log(nearby @ se3.inverse(mount)) / _NUDGE
    mount[:, :3, 3] += out[:, None] * mount[:, :3, 2]
    mount = mount @ readings.mount
    placed = {"arclength": where, "mount": mount, "beside": beside, "winding": winding}
    return readings.changed(**placed, channel=None)


def _positions(
    channel: Channel, travel: Array, places: Array, bent: Array, nodes: Array
) -> tuple[Array, Array, Array]:
    """Arclengths after travels (M,) in a channel, for strains `bent` (M, P, 6) at places (P,).

    Returns:
        The arclengths (M,); how far the sensor sticks out of the channel (M,), m; and derivatives
        (M, N, 6) of the arclength by the strain at the nodes (N,), taken as linear between them:
        the strain that poses imply between nodes would curve the valley of the cost.
    """
    fine, tangent, lengths = channel_lengths(channel, places, bent)
    speed = np.linalg.norm(tangent, axis=-1)
    inside = np.clip(travel, 0.0, lengths[:, -1])
    rows = range(travel.size)
    where = np.array([np.interp(inside[m], lengths[m], fine) for m in rows])
    here = np.array([np.interp(where[m], fine, speed[m]) for m in rows])
    unit = tangent / speed[..., None]
    by_strain = np.concatenate([unit, np.cross(channel.path(fine)[0], unit)], axis=-1)
    weights = np.stack([up_to(fine, s) for s in where]) / here[:, None]
    slope = -hat_functions(nodes, fine).T @ (weights[..., None] * by_strain)
    return where, travel - inside, slope


def placed(readings: Sequence[Readings], posterior: Posterior) -> list[Readings]:
    """Readings, those in channels located by a posterior's shape; others unchanged."""
    at = posterior.prior, posterior.grid, posterior.state
    return [place_in_channel(r, *at) for r in readings]


def settled(
    solve: Callable[..., Posterior],
    readings: Sequence[Readings],
    rest: tuple[Prior, Grid, State],
    initial: State | None,
) -> Posterior:
    """Locate readings in channels and estimate, in turn, until both agree.

    Args:
        solve: Estimates from located readings, started at nodes (K, N) `initial` or at rest.
        readings: Readings, some of them in channels.
        rest: The prior, the grid, and nodes (K, N) of the shape that locates readings at first.
        initial: Nodes (K, N) to start from, if any.

    Raises:
        SensorError: A travel leaves its channel by more than bending explains.
    """
    for r in readings:
        _require_in_channel(r, float(rest[1].arclength[-1]))
    now = [_rough(r, *rest) for r in readings]
    for _ in range(_ROUNDS):
        posterior = solve(now, initial=initial)
        before, now, initial = now, placed(readings, posterior), posterior.state
        pairs = zip(before, now, strict=True)
        moved = [np.abs(a.arclength - b.arclength).max(initial=0.0) for a, b in pairs]
        if max(moved) < _CLOSE * float(posterior.grid.arclength[-1]):
            break
    return posterior


def _require_in_channel(readings: Readings, length: float) -> None:
    if readings.channel is None:
        return
    low, high = readings.channel.travels(length)
    off = (readings.arclength < low) | (readings.arclength > high)
    if off.any():
        raise SensorError(
            f"{readings.label}: a travel of {readings.arclength[off][0]:g} m leaves the channel, "
            f"of {low:.4g} to {high:.4g} m however the robot bends; correct its zero, or give "
            f"metres."
        )


def _rough(readings: Readings, prior: Prior, grid: Grid, state: State) -> Readings:
    """Readings located by a first shape, with the uncertainty of bending by a radian."""
    if readings.channel is None:
        return readings
    spread = np.hypot(readings.arclength_std, readings.channel.radius)
    placed = place_in_channel(readings, prior, grid, state)
    return placed.changed(arclength_std=spread, beside=None, winding=None)
