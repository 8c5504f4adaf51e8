"""A process that compiles some kernels: `python -m glissando._kernels.compile CLAIMS NAME …`."""

from __future__ import annotations

import gc
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from glissando._kernels import (  # noqa: F401  (importing them registers their kernels)
    block_tridiagonal,
    information,
    intervals,
    matern,
    normal_equations,
    process,
    rod_flow,
    rod_forces,
    rod_intervals,
    rod_motion,
    rod_tip,
    rolls,
    se3,
    sensors,
    state,
    static_steps,
    stationary,
    steps,
    transitions,
    white_noise,
    white_noise_points,
    window,
)
from glissando._kernels.jit import called_from_python, compile_named

_GARBAGE = 100_000  # allocations between collections: a compiler makes hardly any garbage


def translate_whole_kernels_only(names: Collection[str]) -> None:
    """Make numba optimise and translate functions that only kernels call as parts of those.

    By default it also does so for each of them alone, which is never called but two fifths of the
    work. This patches internals of numba in this process, which ends after compiling; if they
    differ from those expected, all is compiled as by default.

    Args:
        names: Names of functions that are called from Python.
    """
    from numba.core import codegen

    library: Any = getattr(codegen, "JITCodeLibrary", None)
    engine: Any = getattr(codegen, "JITCPUCodegen", None)
    changed = ("_optimize_final_module", "_finalize_final_module", "get_pointer_to_function")
    if not all(hasattr(library, name) for name in changed) or not hasattr(engine, "set_env"):
        return
    optimize, finalize, pointer = (getattr(library, name) for name in changed)
    set_environment = engine.set_env

    def optimize_whole(self: Any) -> None:
        if self.name in names:
            optimize(self)

    def finalize_whole(self: Any) -> None:
        if self.name in names:
            finalize(self)
            return
        self._finalize_dynamic_globals()
        self._finalized = True

    def pointer_to_whole(self: Any, name: str) -> int:
        self._ensure_finalized()
        return int(pointer(self, name)) if self.name in names else 0

    def set_environment_of_whole(self: Any, name: str, environment: Any) -> None:
        if self._engine.is_symbol_defined(name):
            set_environment(self, name, environment)

    for name, function in zip(
        changed, (optimize_whole, finalize_whole, pointer_to_whole), strict=True
    ):
        setattr(library, name, function)
    engine.set_env = set_environment_of_whole


if __name__ == "__main__":
    gc.set_threshold(_GARBAGE)
    translate_whole_kernels_only(called_from_python())
    compile_named(Path(sys.argv[1]), sys.argv[2:])
