"""How functions here are compiled, and when what was compiled before is forgotten."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import njit


def jit(function: Any) -> Any:
    """Compile at the first call and keep the result on disk; sums may be done in any order."""
    return njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})(function)


def forget_stale() -> None:
    """Drop what was compiled before any file here changed: numba looks at a function's own only."""
    folder = Path(__file__).parent
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for kept in (folder / "__pycache__").glob("*.nbi"):
        with suppress(FileNotFoundError):  # another process drops it at the same time
            if kept.stat().st_mtime < newest:
                kept.unlink()


forget_stale()
