"""Where a coil is in a channel beside the backbone, by the shape that motion capture shows."""

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
    """Arclengths of travels along a channel, at any time.

    Attributes:
        arclength: Places (F,), m.
        time: Times (K,), s.
        lengths: Lengths (K, F) of the channel up to each place at each time, m.
    """

    arclength: Array
    time: Array
    lengths: Array

    @staticmethod
    def of(channel: Channel, shape: Posterior) -> ChannelMap:
        """The map of a shape whose strain runs straight between its nodes."""
        nodes = shape.grid.arclength
        places, _, lengths = channel_lengths(channel, nodes, shape.state.strain)
        return ChannelMap(places, shape.grid.time, lengths)

    def place(self, travel: Array, time: Array) -> Array:
        """Arclengths (M,) after travels (M,) at times (M,); beyond an end the coil goes on."""
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
    """Derivatives (M, r, N·dof) of residuals by the shape at their times, by where the coil is.

    Args:
        shape: The shape.
        readings: The coil's readings (M,) at travels along their channel.
        by_state: Derivatives (M, r, 18) of the residuals by the states.
        rise: Derivatives (M, 18) of the states by the arclength.

    Source: (M8).
    """
    placed = place_in_channel(readings, shape.prior, shape.grid, shape.state)
    assert placed.beside is not None
    assert placed.winding is not None
    rise = np.concatenate([rise[:, POSE] + placed.winding, rise[:, 6:]], axis=1)
    lean = np.einsum("mrd,md->mr", by_state, rise)
    out = np.zeros((*lean.shape, shape.grid.arclength.size, shape.state.dof))
    out[..., STRAIN] = lean[:, :, None, None] * placed.beside[:, None, 0]
    return out.reshape(*lean.shape, -1)
