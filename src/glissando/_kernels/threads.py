"""BLAS on one thread: more threads are slower for blocks as small as these."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController

_held = threading.local()
_NOTHING = nullcontext()


@cache
def _controller() -> ThreadpoolController:
    """Controller of the BLAS of numpy and of scipy, which kernels call and which is loaded."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController().select(user_api="blas")


def one_thread() -> AbstractContextManager[None]:
    """Limit BLAS to one thread while the context lasts; nested contexts cost nothing.

    OpenBLAS takes the number from the main thread alone: elsewhere set OPENBLAS_NUM_THREADS=1.
    """
    return _NOTHING if getattr(_held, "already", False) else _limited()


@contextmanager
def _limited() -> Iterator[None]:
    _held.already = True
    controller = _controller()
    single_threaded = all(each.num_threads == 1 for each in controller.lib_controllers)
    try:
        with nullcontext() if single_threaded else controller.limit(limits=1):
            yield
    finally:
        _held.already = False
