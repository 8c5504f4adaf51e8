"""Evenly spaced subsets of the rows of long arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def evenly_chosen(count: int, most: int) -> NDArray[np.intp]:
    """Indices of `most` rows spaced evenly from the first to the last of `count`; all if fewer.

    >>> evenly_chosen(100, 4), evenly_chosen(3, 4)
    (array([ 0, 33, 66, 99]), array([0, 1, 2]))
    """
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
