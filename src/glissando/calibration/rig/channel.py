"""Arclength of a coil in a channel beside the backbone, given the shape from motion capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.estimation.channels import place_in_channel
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.sensors.sensors import CoilReadings
from glissando.model.state import POSE, STRAIN
from glissando.model.tendons.channel import Channel
from glissando.model.tendons.travel import channel_lengths


@dataclass(frozen=True)
class ChannelMap:
    """Map from distance along a channel to arclength, at any time.

    Attributes:
        arclength: Arclengths (F,) of the table, m.
        time: Times (K,) of the table, s.
        lengths: Lengths (K, F) of the channel from the base to each arclength at each time, m.
    """

    arclength: Array
    time: Array
    lengths: Array

    @staticmethod
    def of(channel: Channel, shape: Posterior) -> ChannelMap:
        """Map for a shape whose strain is interpolated linearly between its nodes."""
        nodes = shape.grid.arclength
        places, _, lengths = channel_lengths(channel, nodes, shape.state.strain)
        return ChannelMap(places, shape.grid.time, lengths)

    def place(self, travel: Array, time: Array) -> Array:
        """Arclengths (M,) at distances (M,) along the channel and times (M,).

        Beyond an end of the channel, arclength continues with slope 1.
        """
        nodes, out = self.time, np.empty_like(travel)
        fraction = np.interp(time, nodes, np.arange(nodes.size))
        for m, (k, x) in enumerate(zip(fraction.astype(int), fraction % 1.0, strict=True)):
            lengths = (1.0 - x) * self.lengths[k] + x * self.lengths[min(k + 1, nodes.size - 1)]
            inside = min(max(travel[m], 0.0), lengths[-1])
            out[m] = np.interp(inside, lengths, self.arclength) + travel[m] - inside
        return out


def by_strain_along(
    shape: Posterior, readings: CoilReadings, by_state: Array, rise: Array
) -> Array:
    """Jacobians (M, r, N·dof) of residuals through the coil's arclength, by the nodes at each time.

    The strain of all nodes determines the length of the channel, and thus the coil's arclength.

    Args:
        shape: Posterior of the shape.
        readings: The coil's readings (M,), with distances along the channel as arclengths.
        by_state: Jacobians (M, r, 18) of the residuals with respect to the states.
        rise: Derivatives (M, 18) of the states by arclength.

    Source: (M8).
    """
    placed = place_in_channel(readings, shape.prior, shape.grid, shape.state)
    assert placed.beside is not None
    assert placed.winding is not None
    rise = np.concatenate([rise[:, POSE] + placed.winding, rise[:, 6:]], axis=1)
    by_arclength = np.einsum("mrd,md->mr", by_state, rise)
    out = np.zeros((*by_arclength.shape, shape.grid.arclength.size, shape.state.dof))
    out[..., STRAIN] = by_arclength[:, :, None, None] * placed.beside[:, None, 0]
    return out.reshape(*by_arclength.shape, -1)
