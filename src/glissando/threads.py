"""BLAS on one thread: more only fight over blocks as small as ours."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()
_held = threading.local()


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS to one thread while the context lasts; inside another it costs nothing."""
    if getattr(_held, "already", False):
        yield
        return
    _held.already = True
    try:
        with _threads.limit(limits=1, user_api="blas"):
            yield
    finally:
        _held.already = False
