"""Folders that are written whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from glissando.errors import GlissandoError


def require_new(folder: Path, error: type[GlissandoError]) -> None:
    """Require that a folder can be made: it is absent, or an empty folder.

    Args:
        folder: The folder.
        error: Class of the error to raise otherwise.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise error(f"{folder} exists and is no folder; give another --out.")
    if folder.exists() and any(folder.iterdir()):
        raise error(f"{folder} exists and is not empty; give another --out.")


@contextmanager
def new_folder(folder: Path, error: type[GlissandoError]) -> Iterator[Path]:
    """A folder to write into, which becomes `folder` if the context ends without an exception.

    Args:
        folder: The folder to make.
        error: Class of the error to raise when it holds something or is no folder.
    """
    require_new(folder, error)
    folder.parent.mkdir(parents=True, exist_ok=True)
    building = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield building
        building.chmod(0o777 & ~_umask())
        if folder.exists():
            folder.rmdir()
        building.rename(folder)
    except BaseException:
        shutil.rmtree(building, ignore_errors=True)
        raise


def _umask() -> int:
    now = os.umask(0)
    os.umask(now)
    return now
