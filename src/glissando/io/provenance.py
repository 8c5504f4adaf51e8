"""Provenance in files: the version of their format, and of the programs that wrote them."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from glissando import __version__
from glissando.errors import GlissandoError
from glissando.io.atomic import write_text

FORMATS = {"posterior": 2, "recording": 1, "session": 1, "robot": 1, "calibration": 1}
"""Version in which each format is written; earlier versions are read, too (docs/formats.md)."""


def stated_format(kind: str) -> str:
    """Text by which a file states its format.

    >>> stated_format("recording")
    'glissando recording 1'
    """
    return f"glissando {kind} {FORMATS[kind]}"


def require_readable(
    stated: object, kind: str, where: str | Path, error: type[GlissandoError] = GlissandoError
) -> None:
    """Require that a file is of a format that this version reads.

    Args:
        stated: Format stated in the file; None or empty means this version's.
        kind: Kind of file, a key of FORMATS.
        where: The file, for the message.
        error: Class of the error.

    Raises:
        GlissandoError: The file is of another kind, or was written by a later version.
    """
    match = re.fullmatch(rf"glissando {kind} ([1-9]\d{{0,3}})", str(stated or stated_format(kind)))
    if match is None:
        raise error(
            f"{where} is not a glissando {kind}: its format is {str(stated)[:60]!r}; give one of "
            f"format {stated_format(kind)!r}."
        )
    if int(match[1]) > FORMATS[kind]:
        raise error(
            f"{where} is a {match[0]!r}, which a later version wrote; this one, {__version__}, "
            f"reads up to {stated_format(kind)!r}. Install a newer glissando."
        )


@cache
def versions() -> dict[str, str]:
    """Versions of the programs on which numerical results depend.

    >>> list(versions())
    ['python', 'glissando', 'numpy', 'scipy', 'numba']
    """
    return {
        "python": platform.python_version(),
        "glissando": __version__,
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
    }


def made_by() -> str:
    """Name and version of this program, as stated in text files."""
    return f"glissando {__version__}"


def write_report(path: Path, document: Mapping[str, Any]) -> None:
    """Write results as JSON with the versions that made them, whole or not at all.

    Args:
        path: The file to write.
        document: Results, of types that JSON has.

    Raises:
        GlissandoError: The file cannot be written.
    """
    write_text(path, json.dumps({**document, "versions": versions()}, indent=2) + "\n")


def digests(files: Iterable[Path]) -> dict[str, str]:
    """SHA-256 digests of files, by file name.

    Raises:
        GlissandoError: A file cannot be read.
    """
    try:
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    except OSError as problem:
        raise GlissandoError(f"{problem.filename} cannot be read ({problem.strerror}).") from None
