"""Files and folders that are written whole or not at all.

Each is built under a temporary path, then renamed into place; a file is flushed to disk before.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array

_BUILDING = ".writing-"  # first letters of a temporary folder's name


@contextmanager
def new_file(path: str | Path) -> Iterator[Path]:
    """A new file that replaces `path` if the context ends without an exception.

    If the writer fails or is killed, an existing file stays unchanged; after a kill a hidden folder
    beside it may remain. A path that is not a regular file, such as a pipe, is written directly.

    Args:
        path: File to write; its folder is created if it is missing.

    Yields:
        Path to write to, of the same name in a temporary folder.

    Raises:
        GlissandoError: The file cannot be written; the message gives the system's reason.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            yield path
            return
        target = Path(os.path.realpath(path))  # a link stays one
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=_BUILDING, dir=target.parent, ignore_cleanup_errors=True
        ) as folder:
            building = Path(folder, target.name)
            yield building
            with building.open("rb+") as file:
                os.fsync(file.fileno())
            building.replace(target)
    except OSError as problem:
        reason = problem.strerror or str(problem)
        # folders that are being built have names of which the user knows nothing
        shown = Path(*(part for part in path.parts if not part.startswith(_BUILDING)))
        unharmed = "; what was there is as it was" if shown.exists() else ""
        raise GlissandoError(
            f"{shown} cannot be written ({reason}){unharmed}. Free space, or give another name."
        ) from problem


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all.

    Args:
        path: File to write; its folder is created if it is missing.
        text: Content of the file.

    Raises:
        GlissandoError: The file cannot be written.
    """
    with new_file(path) as building:
        building.write_text(text, encoding="utf-8")


def write_table(path: str | Path, columns: Sequence[str], table: Array) -> None:
    """Write numbers as CSV with a header line, whole or not at all; times keep all their digits.

    Args:
        path: File to write; its folder is created if it is missing.
        columns: Names of the columns.
        table: Rows (M, C).

    Raises:
        GlissandoError: The file cannot be written.
    """
    with new_file(path) as building:
        np.savetxt(building, table, formats(columns), ",", header=",".join(columns), comments="")


def formats(columns: Sequence[str]) -> list[str]:
    """Number formats of the columns: a time in the fewest digits that are exact, else 12 digits.

    >>> ",".join(formats(["time", "x"])) % (1700000000.123456, 0.1 + 0.2)
    '1700000000.123456,0.3'
    """
    return ["%s" if name == "time" else "%.12g" for name in columns]


def require_new(folder: Path, error: type[GlissandoError]) -> None:
    """Require that a folder can be created: its path is free or is an empty folder.

    Args:
        folder: The folder.
        error: Class of the error to raise otherwise.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise error(f"{folder} exists and is not a folder; give another --out.")
    if folder.exists() and any(folder.iterdir()):
        raise error(f"{folder} exists and is not empty; give another --out.")


@contextmanager
def new_folder(folder: Path, error: type[GlissandoError]) -> Iterator[Path]:
    """A temporary folder that is renamed to `folder` if the context ends without an exception.

    Args:
        folder: Folder to create.
        error: Class of the error to raise if the path is a folder with content or not a folder.
    """
    require_new(folder, error)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        prefix=_BUILDING, dir=folder.parent, ignore_cleanup_errors=True
    ) as temporary:
        building = Path(temporary, folder.name)  # with the usual permissions, unlike `temporary`
        building.mkdir()
        yield building
        if folder.exists():
            folder.rmdir()
        building.rename(folder)


@contextmanager
def renewed_folder(folder: Path, owned: Collection[str]) -> Iterator[Path]:
    """A temporary folder whose files replace those of an earlier run in `folder`.

    The files in `folder` stay unchanged until the context ends without an exception. Then all files
    named in `owned`, which belong to the earlier run, are deleted and the new files are moved in.
    Files of other names stay.

    Args:
        folder: Folder whose files are replaced; created if it is missing.
        owned: Names of all files that such a run may write.

    Yields:
        Temporary folder to write into.

    Raises:
        GlissandoError: The folder cannot be written to; the message gives the system's reason.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=_BUILDING, dir=folder, ignore_cleanup_errors=True
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
