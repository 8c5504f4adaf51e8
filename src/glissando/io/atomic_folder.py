"""Folders that are written whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator
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
    with tempfile.TemporaryDirectory(
        prefix=f".{folder.name}-", dir=folder.parent, ignore_cleanup_errors=True
    ) as place:
        building = Path(place, folder.name)  # of the usual permissions, unlike the place
        building.mkdir()
        yield building
        if folder.exists():
            folder.rmdir()
        building.rename(folder)


@contextmanager
def renewed_folder(folder: Path, owned: Collection[str]) -> Iterator[Path]:
    """A folder to write into, whose files take the place of those of an earlier run.

    Until the context ends without an exception the files in `folder` stay as they were; then those
    of the names `owned` go, for they belong to the earlier run, and the new ones come. Files of
    other names stay.

    Args:
        folder: The folder whose files are renewed; made if it is missing.
        owned: Names of all files that such a run may write.

    Yields:
        The folder to write into.

    Raises:
        GlissandoError: The disk refused; the sentence says why.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=".writing-", dir=folder, ignore_cleanup_errors=True
        ) as building:
            yield Path(building)
            for name in owned:
                (folder / name).unlink(missing_ok=True)
            for path in sorted(Path(building).iterdir()):
                path.replace(folder / path.name)
    except OSError as problem:
        raise GlissandoError(
            f"{folder} cannot be written to ({problem.strerror or problem}); free space, or give "
            f"another folder."
        ) from problem
