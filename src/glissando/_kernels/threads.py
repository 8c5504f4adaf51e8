"""BLAS on one thread: more only fight over blocks as small as ours."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()
_blas = _threads.select(user_api="blas").lib_controllers
_held = threading.local()


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS to one thread while the context lasts; it costs nothing where it is already."""
    if getattr(_held, "already", False):
        yield
        return
    _held.already = True
    alone = all(each.num_threads == 1 for each in _blas)
    try:
        with nullcontext() if alone else _threads.limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.already = False
