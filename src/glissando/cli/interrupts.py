"""Handling of Ctrl-C, which numba turns into a SystemError inside a compiled kernel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from glissando.errors import is_interrupt


@contextmanager
def until_interrupted() -> Iterator[None]:
    """Context that Ctrl-C ends without an exception, also inside a kernel."""
    try:
        yield
    except (KeyboardInterrupt, SystemError) as problem:
        if not is_interrupt(problem):
            raise
