"""Arrays as kernels take them: contiguous lists of items."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def items(values: Array | float, lead: tuple[int, ...], *own: int) -> Array:
    """Values broadcast to `lead` + `own` as one list (M, *own) of contiguous numbers."""
    array = np.asarray(values, dtype=float)
    if array.shape != (*lead, *own):
        spread = np.empty((*lead, *own))  # several times faster than to broadcast and to copy
        spread[...] = array
        array = spread
    return whole(array).reshape(-1, *own)


def whole(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself if it is contiguous and writable, as kernels require, else a copy."""
    array = np.ascontiguousarray(array)
    return array if array.flags.writeable else array.copy()


def unflatten(lead: tuple[int, ...], *lists: Array) -> tuple[Array, ...]:
    """Restore the leading shape of lists (M, …) that `items` flattened."""
    return tuple(each.reshape(*lead, *each.shape[1:]) for each in lists)
