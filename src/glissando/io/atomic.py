"""Files and folders that are written whole or not at all.

They are made aside, flushed to disk, then renamed into place.
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


@contextmanager
def new_file(path: str | Path) -> Iterator[Path]:
    """A file to write, which takes the place of `path` if the context ends without an exception.

    Whatever stops the writer before, the file that was there stays as it was; after a kill a hidden
    folder beside it may remain. What is no plain file, such as a pipe, is written directly.

    Args:
        path: The file to write; its folder is made if it is missing.

    Yields:
        The path to write to, of the same name in a folder of its own.

    Raises:
        GlissandoError: The disk refused; the sentence says why.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            yield path
            return
        place = Path(os.path.realpath(path))  # a link stays one
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=".writing-", dir=place.parent, ignore_cleanup_errors=True
        ) as folder:
            building = Path(folder, place.name)
            yield building
            with building.open("rb+") as file:
                os.fsync(file.fileno())
            building.replace(place)
    except OSError as problem:
        reason = problem.strerror or str(problem)
        unharmed = "; what was there is as it was" if path.exists() else ""
        raise GlissandoError(
            f"{path} cannot be written ({reason}){unharmed}. Free space, or give another name."
        ) from problem


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all.

    Args:
        path: The file to write; its folder is made if it is missing.
        text: What it will hold.

    Raises:
        GlissandoError: The disk refused.
    """
    with new_file(path) as building:
        building.write_text(text, encoding="utf-8")


def write_table(path: str | Path, columns: Sequence[str], table: Array) -> None:
    """Write numbers as CSV with a header line, whole or not at all; times keep all their digits.

    Args:
        path: The file to write; its folder is made if it is missing.
        columns: Names of the columns.
        table: The rows (M, C).

    Raises:
        GlissandoError: The disk refused.
    """
    with new_file(path) as building:
        np.savetxt(building, table, formats(columns), ",", header=",".join(columns), comments="")


def formats(columns: Sequence[str]) -> list[str]:
    """How the numbers of each column are written: a time as short as it stays exact.

    >>> ",".join(formats(["time", "x"])) % (1700000000.123456, 0.1 + 0.2)
    '1700000000.123456,0.3'
    """
    return ["%s" if name == "time" else "%.12g" for name in columns]


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
