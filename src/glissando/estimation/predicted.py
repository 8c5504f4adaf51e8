"""What a window says ahead of its readings, where belief becomes too wide to be linear."""

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
    """The state at places and times (…); what its last node says holds from then on.

    Later than all that was read the spread of shapes stands for a belief that is wide, each time's
    that of the next node.

    Args:
        window: It, with nodes ahead.
        place: Metres.
        time: Seconds, not before its first node.
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
