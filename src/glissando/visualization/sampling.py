"""Points at which pictures query an estimate: nodes and, where variance is larger, between them."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array


def drawn_at(nodes: Array, steps: int, most: int | None = None) -> Array:
    """Sample points of a figure, page or film along arclength or time.

    Every interval between nodes is divided equally, at least in two; if that exceeds `most`, some
    of the nodes and equally many midpoints are kept, evenly spread.

    Args:
        nodes: Nodes (K,), m or s.
        steps: Minimum number of steps.
        most: Maximum number of points; None for no limit.

    Returns:
        Points (P,) from the first node to the last.

    >>> drawn_at(np.array([0.0, 1.0, 2.0]), 3).tolist()
    [0.0, 0.5, 1.0, 1.5, 2.0]
    """
    intervals = nodes.size - 1
    if not intervals:
        return nodes
    cuts = max(2, int(np.ceil(steps / intervals - 1e-9)))
    places = np.arange(cuts * intervals + 1) / cuts
    if most is not None and places.size > most:
        halves = np.linspace(0, 2 * intervals, most - 1 + most % 2).round()
        halves[1::2] += 1.0 - halves[1::2] % 2.0
        halves[0::2] -= halves[0::2] % 2.0
        places = np.unique(halves) / 2.0
    return np.interp(places, np.arange(nodes.size), nodes)
