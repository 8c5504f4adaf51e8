"""Sensors that slide in a channel beside the backbone: where they are follows from the shape.

The arclength of their readings is a travel along the channel, whose length depends on the strain
all the way from the base: dσ/ds = |ν + u × r + dr/ds|. Source: (M8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from glissando.errors import SensorError
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.tendons import up_to
from glissando.model.state import State
from glissando.model.tendons.travel import channel_lengths
from glissando.solver.measurement_factors import states_at

_BEYOND = 2.0 * np.pi  # radii, by which a travel may leave the channel: a whole turn of bending
_ROUNDS = 8
_CLOSE = 2e-5  # of the length, by which readings may still move in their channels
_CHUNK = 200  # readings at a time, to bound memory


def place_in_channel(readings: Readings, prior: Prior, grid: Grid, state: State) -> Readings:
    """Readings of a sensor in a channel as those of one in the cross-section it is beside.

    Arclengths become those of the backbone and the mount that of a sensor which points along the
    channel; `beside` says how the arclengths change with the strain at the nodes.

    Args:
        readings: Readings (M,); those of a sensor without a channel are returned as they are.
        prior: What lies between the nodes.
        grid: The nodes.
        state: Nodes (K, N) of the shape.

    Raises:
        SensorError: A travel leaves the channel by more than bending explains.
    """
    channel = readings.channel
    if channel is None:
        return readings
    count, nodes = len(readings), grid.arclength
    where = np.empty(count)
    beside = np.empty((count, 2, nodes.size, 6))
    places = np.union1d(nodes, 0.5 * (nodes[1:] + nodes[:-1]))
    time = np.clip(readings.time, grid.time[0], grid.time[-1])
    for first in range(0, count, _CHUNK):
        rows = slice(first, min(first + _CHUNK, count))
        points = np.tile(places, time[rows].size), np.repeat(time[rows], places.size)
        along = states_at(prior, grid, state, *points).strain.reshape(-1, places.size, 6)
        for m, bent in enumerate(along, start=first):
            where[m], slope = _found(readings, m, places, bent, nodes)
            beside[m] = slope, bent[np.searchsorted(places, nodes)]
    # as the rod is when straight: a mount that followed twist would confirm it
    mount = channel.frame(where, np.tile(STRAIGHT, (count, 1))) @ readings.mount
    return replace(readings, arclength=where, mount=mount, channel=None, beside=beside)


def _found(
    readings: Readings, m: int, places: Array, bent: Array, nodes: Array
) -> tuple[float, Array]:
    """Arclength of a reading where strain is `bent` (P, 6) at places, and its slopes (N, 6).

    They are how it changes with the strain at the nodes (N,).
    """
    channel, travel = readings.channel, float(readings.arclength[m])
    assert channel is not None
    fine, lengths = channel_lengths(channel, places, bent)
    spare = _BEYOND * channel.radius
    if not -spare <= travel <= lengths[-1] + spare:
        raise SensorError(
            f"{readings.label}: a travel of {travel:g} m leaves the channel of {lengths[-1]:.4g} "
            f"m; correct its zero, or give metres."
        )
    where = float(np.interp(travel, lengths, fine))
    strain = np.stack([np.interp(fine, places, column) for column in bent.T], axis=-1)
    tangent = channel.tangent(fine, strain)
    speed = np.linalg.norm(tangent, axis=-1)
    unit = tangent / speed[:, None]
    by_strain = np.concatenate([unit, np.cross(channel.path(fine)[0], unit)], axis=-1)
    hats = np.stack([np.interp(fine, nodes, row) for row in np.eye(nodes.size)])
    slope = -(hats * up_to(fine, where)) @ by_strain / np.interp(where, fine, speed)
    return where, slope


def placed(readings: Sequence[Readings], posterior: Posterior) -> list[Readings]:
    """Readings where a posterior says that those in channels were taken; others as they are."""
    at = posterior.prior, posterior.grid, posterior.state
    return [place_in_channel(r, *at) for r in readings]


def settled(
    solve: Callable[[Sequence[Readings], State | None], Posterior],
    readings: Sequence[Readings],
    rest: tuple[Prior, Grid, State],
    initial: State | None,
) -> Posterior:
    """The posterior for which readings in channels are where it says itself.

    Args:
        solve: Gives the posterior of readings that are placed, from a start or from rest.
        readings: Readings, some of them in channels.
        rest: The prior, the grid, and nodes (K, N) of the shape to place readings by at first.
        initial: Nodes (K, N) to start from, if any.
    """
    now = [_rough(r, *rest) for r in readings]
    for _ in range(_ROUNDS):
        posterior = solve(now, initial)
        before, now, initial = now, placed(readings, posterior), posterior.state
        pairs = zip(before, now, strict=True)
        moved = [np.abs(a.arclength - b.arclength).max(initial=0.0) for a, b in pairs]
        if max(moved) < _CLOSE * float(posterior.grid.arclength[-1]):
            break
    return posterior


def _rough(readings: Readings, prior: Prior, grid: Grid, state: State) -> Readings:
    """Readings about where a first shape puts them, as uncertain as a bend by a radian makes it."""
    if readings.channel is None:
        return readings
    spread = np.hypot(readings.arclength_std, readings.channel.radius)
    found = place_in_channel(readings, prior, grid, state)
    return replace(found, arclength_std=spread, beside=None)
