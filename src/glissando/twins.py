"""A compiled function in place of one of numpy's, where numba is installed.

The functions marked `twin` are exact definitions in numpy, batched; on a handful of items most of
their time is numpy's calls. `glissando.compiled` has a function of the same name and arguments for
each, which is used instead unless numba is missing or GLISSANDO_COMPILED is 0.
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


@cache
def compiled() -> ModuleType | None:
    """The room of compiled functions, None where it is not to be used."""
    if os.environ.get("GLISSANDO_COMPILED") == "0" or find_spec("numba") is None:
        return None
    return import_module("glissando.compiled")  # at the first call: numba takes long to import


def twin(slow: Callable[P, R]) -> Callable[P, R]:
    """The function, or its compiled twin where there is one to use.

    The definition itself stays at hand in TWINS.
    """
    TWINS[slow.__name__] = slow
    chosen: list[Callable[P, R]] = []

    @wraps(slow)
    def either(*args: P.args, **kwargs: P.kwargs) -> R:
        if not chosen:
            chosen.append(getattr(compiled(), slow.__name__, slow))
        return chosen[0](*args, **kwargs)

    return either


@cache
def prepare() -> None:
    """Have all compiled functions at hand, so that no later call has to wait for them."""
    room = compiled()
    if room is not None:
        room.prepare()
