"""Prediction of a window ahead of its readings, where covariances become too large to be linear."""

from __future__ import annotations

import numpy as np

from glissando.estimation.reading_pause import is_curved
from glissando.estimation.shape_spread import (
    ShapeSpread,
    between_nodes,
    shape_covariances,
    tip_spread,
)
from glissando.estimation.sliding_window import SlidingWindow
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry.se3 import Array


def predicted(window: SlidingWindow, place: Array, time: Array, since: float) -> StateEstimate:
    """States at places and times (…); after the last node its state remains valid.

    After the newest reading, covariances that are too large to be linear are replaced by the spread
    of shapes at the next node.

    Args:
        window: Sliding window whose last nodes lie ahead of the readings.
        place: Arclengths, m.
        time: Times, s, not before the window's first node.
        since: Time of the newest node with a reading, s.
    """
    posterior, arclength = window.posterior(), window.arclength
    nodes = posterior.grid.time
    held = np.minimum(time, nodes[-1])
    found = posterior.at(place, held)
    if arclength.size == 1:
        return found
    node = np.asarray(np.searchsorted(nodes, held))
    for k in np.unique(node[time > since]):
        state, joint = posterior.state.take(k), posterior.marginals.cov[k]
        if is_curved(tip_spread(state, joint)):
            found = found if isinstance(found, ShapeSpread) else ShapeSpread.of(found)
            shapes = shape_covariances(arclength, state, joint)
            found.cov[node == k] = between_nodes(arclength, shapes, place[node == k])
    return found
