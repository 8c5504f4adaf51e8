"""Reuse of the memory of large arrays by successive estimates."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_SIZES = 1 << 25, 1 << 30  # bytes; older versions of glibc take no more than the first


@cache
def keep_freed_memory() -> None:
    """Make the C library, if it is glibc, keep freed memory of arrays of up to 1 GB.

    By default it returns large blocks to the system, which provides them again page by page,
    zeroed: up to a fifth of an estimate's time. The process then keeps its largest size.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library, or Windows
        mallopt = ctypes.CDLL(None).mallopt
        for size in _SIZES:
            mallopt(_TRIM_THRESHOLD, size)
            mallopt(_MMAP_THRESHOLD, size)
