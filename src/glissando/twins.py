"""A compiled function in place of one of numpy's, where numba is installed.

The functions marked `twin` are exact definitions in numpy, batched; on a handful of items most of
their time is numpy's calls. `glissando.compiled` has a function of the same name and arguments for
each, which estimators use instead unless numba is missing or GLISSANDO_COMPILED is 0.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

TWINS: dict[str, Callable[..., Any]] = {}
"""The definitions in numpy of all functions that have a compiled twin, by name."""


_rooms: list[ModuleType] = []


@cache
def use_compiled() -> None:
    """From now on use compiled functions in this process, where there are any to use.

    Whoever estimates calls this first. Nothing else does: numba takes a second to import, which a
    device's process or thread cannot wait for.
    """
    if os.environ.get("GLISSANDO_COMPILED") != "0" and find_spec("numba") is not None:
        _rooms.append(import_module("glissando.compiled"))


@cache
def prepare() -> None:
    """Have all compiled functions at hand, so that no later call has to wait for them."""
    use_compiled()
    for room in _rooms:
        room.prepare()


def twin(slow: Callable[P, R]) -> Callable[P, R]:
    """The function, or its compiled twin once those are in use.

    The definition itself stays at hand in TWINS.
    """
    TWINS[slow.__name__] = slow
    fast: list[Callable[P, R]] = []

    @wraps(slow)
    def either(*args: P.args, **kwargs: P.kwargs) -> R:
        if not _rooms:
            return slow(*args, **kwargs)
        if not fast:
            fast.append(getattr(_rooms[0], slow.__name__))
        return fast[0](*args, **kwargs)

    return either
