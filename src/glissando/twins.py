"""A compiled function in place of one of numpy's, where numba is installed.

The functions marked `twin` are exact definitions in numpy, batched; on a handful of items most of
their time is numpy's calls. `glissando._kernels` has a function of the same name and arguments for
each, which estimators use instead unless numba is missing or GLISSANDO_COMPILED is 0.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from glissando._kernels.threads import one_thread

P = ParamSpec("P")
R = TypeVar("R")

TWINS: dict[str, Callable[..., Any]] = {}
"""The definitions in numpy of all functions that have a compiled twin, by name."""


_here = threading.local()


@cache
def _compiled() -> ModuleType | None:
    """The room of compiled functions; None where it is not wanted or numba is missing."""
    if os.environ.get("GLISSANDO_COMPILED") == "0" or find_spec("numba") is None:
        return None
    return import_module("glissando._kernels.glue")


@contextmanager
def estimating() -> Iterator[None]:
    """Compiled functions where there are any, and BLAS on one thread, while the context lasts.

    In this thread alone: numba takes a second to import, which a device's process or thread cannot
    wait for, and what is simulated is to be the same whether something was estimated before or not.
    """
    before = getattr(_here, "room", None)
    _here.room = _compiled()
    try:
        with one_thread():
            yield
    finally:
        _here.room = before


@cache
def prepare() -> None:
    """Have all compiled functions at hand, so that no later call has to wait for them."""
    room = _compiled()
    if room is not None:
        with estimating():
            room.prepare()


def twin(slow: Callable[P, R]) -> Callable[P, R]:
    """The function, or its compiled twin while something is estimated.

    The definition itself stays at hand in TWINS.
    """
    TWINS[slow.__name__] = slow

    @wraps(slow)
    def either(*args: P.args, **kwargs: P.kwargs) -> R:
        room = getattr(_here, "room", None)
        function = slow if room is None else getattr(room, slow.__name__)
        return function(*args, **kwargs)

    return either
