"""Ctrl-C inside a compiled kernel, of which numba makes a SystemError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


def is_interrupt(problem: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error, directly or inside a kernel."""
    while problem is not None and not isinstance(problem, KeyboardInterrupt):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


@contextmanager
def until_interrupted() -> Iterator[None]:
    """Go on after the block when Ctrl-C ends it, also inside a kernel."""
    try:
        yield
    except (KeyboardInterrupt, SystemError) as problem:
        if not is_interrupt(problem):
            raise
