"""BLAS on one thread: more only fight over blocks as small as ours."""

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
    """What controls numpy's BLAS and scipy's, which kernels call and which is loaded for it."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController().select(user_api="blas")


def one_thread() -> AbstractContextManager[None]:
    """Hold BLAS to one thread while the context lasts; it costs nothing where it is already.

    OpenBLAS takes the number from the main thread alone: elsewhere set OPENBLAS_NUM_THREADS=1.
    """
    return _NOTHING if getattr(_held, "already", False) else _limited()


@contextmanager
def _limited() -> Iterator[None]:
    _held.already = True
    controller = _controller()
    alone = all(each.num_threads == 1 for each in controller.lib_controllers)
    try:
        with nullcontext() if alone else controller.limit(limits=1):
            yield
    finally:
        _held.already = False
