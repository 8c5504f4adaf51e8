"""Arrays as compiled loops take them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glissando.geometry.se3 import Array


def items(values: Array | float, lead: tuple[int, ...], *own: int) -> Array:
    """Values of every item as one list (M, *own) of contiguous numbers."""
    array = np.asarray(values, dtype=float)
    if array.shape != (*lead, *own):
        spread = np.empty((*lead, *own))  # several times faster than to broadcast and to copy
        spread[...] = array
        array = spread
    return whole(array).reshape(-1, *own)


def whole(array: NDArray[Any]) -> NDArray[Any]:
    """Contiguous and writable, as numba compiles anew for every other kind."""
    array = np.ascontiguousarray(array)
    return array if array.flags.writeable else array.copy()
