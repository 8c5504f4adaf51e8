"""Ctrl-C inside a compiled kernel, of which numba makes a SystemError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from glissando.errors import is_interrupt


@contextmanager
def until_interrupted() -> Iterator[None]:
    """Go on after the block when Ctrl-C ends it, also inside a kernel."""
    try:
        yield
    except (KeyboardInterrupt, SystemError) as problem:
        if not is_interrupt(problem):
            raise
