"""BLAS on one thread: more only fight over blocks as small as ours."""

from __future__ import annotations

from contextlib import AbstractContextManager

from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Hold BLAS to one thread while the context lasts."""
    return _threads.limit(limits=1, user_api="blas")
