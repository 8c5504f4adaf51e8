"""Memory of large arrays: what one estimate frees, the next one fills again."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_SIZES = 1 << 25, 1 << 30  # bytes; older versions of glibc take no more than the first


@cache
def keep_freed_memory() -> None:
    """Let the C library keep what arrays of up to 1 GB free, if it is glibc.

    It gives large blocks back to the system otherwise, which hands them out again page by page,
    zeroed: up to a fifth of an estimate's time. A process then stays as large as it once was.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library, or Windows
        mallopt = ctypes.CDLL(None).mallopt
        for size in _SIZES:
            mallopt(_TRIM_THRESHOLD, size)
            mallopt(_MMAP_THRESHOLD, size)
