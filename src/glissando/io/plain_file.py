"""Checks of files and names from other sources: regular files of limited size, safe names."""

from __future__ import annotations

import errno
import os
import stat
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from glissando.errors import GlissandoError

_MOST = 1 << 31  # bytes of a text
_LONGEST_NAME = 200  # bytes
_PACKED, _LEAST = 50, 1 << 24  # bytes that one byte of a file may unpack to; always allowed
_DEFLATED = 1032  # bytes that one byte of deflate unpacks to at most
_MEMORY = 1 << 34  # bytes that a machine is taken to have if it does not say


def largest_unpacked(size: int) -> int:
    """Largest unpacked size, bytes, that is accepted of a compressed file of a size in bytes.

    Measured data compress little; a file that unpacks to more was made to exhaust the memory.
    """
    return max(_PACKED * size, _LEAST)


def largest_deflated(size: int) -> int:
    """Largest unpacked size, bytes, of a deflated file of a size in bytes, at most the memory.

    Computed data may compress well: the matrices of fine grids are mostly zero.
    """
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # Windows
        memory = _MEMORY
    return min(max(_DEFLATED * size, _LEAST), memory)


def require_plain(path: Path, most: int = _MOST) -> None:
    """Raise OSError unless a path is a regular file: not a pipe, a device or a folder.

    Args:
        path: The path, which may be invalid, as a name read from another file.
        most: Largest accepted size, bytes.
    """
    try:
        status = path.stat()
    except ValueError:
        raise OSError(errno.EINVAL, "no file has such a name") from None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if status.st_size > most:
        raise OSError(errno.EFBIG, f"it has {status.st_size:,} bytes, and {most:,} are read")


def plain_text(path: Path, *, otherwise: str = "") -> str:
    """Read the text of a regular file in UTF-8, or in UTF-16 with a byte order mark.

    Args:
        path: The file.
        otherwise: Encoding of text that is not UTF-8; undefined bytes are replaced.

    Raises:
        OSError: The path is not a regular file, or cannot be read.
        UnicodeDecodeError: The text is not UTF-8, and no other encoding is given.
    """
    require_plain(path)
    content = path.read_bytes()
    marked = content.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError:
        if not otherwise:
            raise
        text = content.decode(otherwise, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def file_stem(name: str, error: type[GlissandoError] = GlissandoError) -> str:
    """Check that a name from another source is safe as the stem of a file name, and return it.

    Args:
        name: Name of a stream, a coil or a body.
        error: Class of the error to raise otherwise.

    Raises:
        GlissandoError: The name is empty, begins with a point, contains a path separator, cannot
            be printed, or is too long.

    >>> file_stem("mocap_700")
    'mocap_700'
    """
    length = len(name.encode("utf-8", "replace"))
    plain = name.isprintable() and not set(name) & set("/\\") and not name.startswith(".")
    if not plain or not name.strip() or length > _LONGEST_NAME:
        raise error(
            f"The name {name[:60]!r} cannot be that of a file; give one of 1 to {_LONGEST_NAME} "
            f"letters, digits and signs, without / and \\ and without a point in front."
        )
    return name
