"""Arclength of a sensor that slides in a channel off the axis: travel depends on the shape."""

from __future__ import annotations

import numpy as np

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.tendons.channel import Channel

_STEPS = 8  # parts that an interval between nodes is divided into


def arclength_of(channel: Channel, nodes: Array, strain: Array, travel: Array) -> Array:
    """Arclengths (…,) on the backbone, m, of a sensor after travels (…,) from the base.

    Args:
        channel: The channel.
        nodes: Arclengths (N,) where strain is known, from 0 up, m.
        strain: Strain there (N, 6), linear between.
        travel: Travel along the channel by an encoder, less its zero, m.

    Raises:
        SensorError: A travel leaves the channel.

    Source: (M8).
    """
    places, _, lengths = channel_lengths(channel, nodes, strain)
    off = np.asarray(travel)
    off = off[(off < -1e-9) | (off > lengths[-1] + 1e-9)]
    if off.size:
        raise SensorError(
            f"A travel of {off.ravel()[0]:g} m leaves the channel of {lengths[-1]:g} m; correct "
            f"its zero, or give metres."
        )
    return np.interp(travel, lengths, places)


def channel_lengths(channel: Channel, nodes: Array, strain: Array) -> tuple[Array, Array, Array]:
    """Finely spaced arclengths, the channel's tangents there, and its length up to each.

    Args:
        channel: The channel.
        nodes: Arclengths (N,) where strain is known, from 0 up, m.
        strain: Strain there (…, N, 6), linear between.

    Returns:
        Arclengths (F,), tangents (…, F, 3), whose norm is dσ/ds, and lengths (…, F).
    """
    fine = np.linspace(nodes[:-1], nodes[1:], _STEPS, endpoint=False, axis=-1).ravel()
    fine = np.append(fine, nodes[-1])
    tangent = channel.tangent(fine, hat_functions(nodes, fine) @ strain)
    speed = np.linalg.norm(tangent, axis=-1)
    steps = 0.5 * (speed[..., 1:] + speed[..., :-1]) * np.diff(fine)
    lengths = np.concatenate([np.zeros_like(speed[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)
    return fine, tangent, lengths


def hat_functions(nodes: Array, arclength: Array) -> Array:
    """Matrix (P, N) of linear interpolation from nodes (N,) to arclengths (P,)."""
    return np.stack([np.interp(arclength, nodes, row) for row in np.eye(nodes.size)], axis=-1)
