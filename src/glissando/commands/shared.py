"""What several commands need."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TypeAlias

from glissando.errors import GlissandoError

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""Where a command adds its parser."""


def names(text: str) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def require_writable(folder: Path) -> None:
    """Raise, before any work is done, unless results can be written into the folder."""
    above = next((p for p in (folder, *folder.absolute().parents) if p.exists()), folder)
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise GlissandoError(f"--out {folder}: {above} is not a folder that can be written to.")
