"""What commands write: where it may go, never over data, and what it states of how it was made."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w

from glissando.errors import GlissandoError
from glissando.io.atomic import write_text
from glissando.io.csv_stream import is_public
from glissando.io.provenance import digests, made_by, stated_format
from glissando.io.session_recording import LOG
from glissando.io.shipped_robots import robot_file
from glissando.model.robot import Robot

_TOML = "recording.toml"
_DATA = ".csv", ".mcap", ".nc", ".json", ".toml"
PAGE = ("<!doctype html", "<!DOCTYPE html")
LEARNED = "# Learned from recordings by "


def require_replaceable(
    option: str, out: Path, *inputs: str | Path | None, begins: Sequence[str] = ()
) -> None:
    """Make sure, before any work is done, that a file to write replaces nobody's data.

    Args:
        option: The option that names the file, such as --out.
        out: File to write.
        inputs: Files and folders that the command reads; None where one is not given.
        begins: How files begin that the command writes; no other file is replaced, if given.

    Raises:
        GlissandoError: The file is one of the inputs, data in one of them or in a recording, or
            none that this command writes.
    """
    if not out.exists():
        return
    real, given = out.resolve(), [Path(each).resolve() for each in inputs if each is not None]
    held = any(
        folder in given or _is_recording(folder) for folder in (real.parent, out.parent.resolve())
    )
    if real in given or (held and real.suffix in _DATA):
        raise GlissandoError(f"{option} {out} would replace data; give another name or folder.")
    if begins and real.is_file():
        with real.open(encoding="utf-8", errors="replace") as file:
            begun = file.read(max(map(len, begins)))
        if begun and not begun.startswith(tuple(begins)):
            raise GlissandoError(
                f"{option} {out} is there and none that this command writes; give another name, "
                f"or delete it first."
            )


def _is_recording(folder: Path) -> bool:
    """Whether a folder is a recording, described, a session's or of the public layout."""
    described = any((folder / name).is_file() for name in (_TOML, LOG))
    return described or any(is_public(file) for file in folder.glob("*.csv"))


def stated(options: argparse.Namespace, robot: Robot | None = None) -> dict[str, Any]:
    """What a report states for `glissando rerun`: the words of the command, digests of its inputs.

    Args:
        options: The options of the command.
        robot: The robot, where a recording may have brought it.

    Returns:
        `request`, the words after `glissando` without --out; `inputs`, the SHA-256 of every file
        that an option names, those of a folder by their names, a file by its option; `seed`, if
        there is one.
    """
    digests: dict[str, str] = {}
    for option, value in vars(options).items():
        for one in value if isinstance(value, list) else [value]:
            if option != "out" and isinstance(one, Path) and one.exists():
                digests |= _digests_of(one, f"--{option}")
    name = getattr(options, "robot", None)
    file = robot_file(name) if name else robot.file if robot else None
    if file:
        digests |= _digests_of(file, "--robot")
    seed = {"seed": options.seed} if hasattr(options, "seed") else {}
    return {"request": _without_out(options.words), "inputs": digests, **seed}


def _without_out(words: list[str]) -> list[str]:
    """The words of a command without `--out DIR`, so that results elsewhere are the same bytes."""
    words_left, left = [], iter(words)
    for word in left:
        flag, equals, _ = word.partition("=")
        if not (len(flag) > 2 and "--out".startswith(flag)):
            words_left.append(word)
        elif not equals:
            next(left)
    return words_left


def _digests_of(path: Path, option: str) -> dict[str, str]:
    if path.is_file():
        return {option: next(iter(digests([path]).values()))}
    kinds = (".csv", ".mcap", ".toml", ".nc")
    return digests(file for file in sorted(path.iterdir()) if file.suffix in kinds)


def require_writable(folder: Path, option: str = "--out") -> None:
    """Make sure, before any work is done, that results can be written into a folder.

    Args:
        folder: The folder, which may not be there yet.
        option: The option that names it, or a file in it.

    Raises:
        GlissandoError: If the folder cannot be made or written to.
    """
    for link in (folder, *folder.absolute().parents):
        if link.is_symlink() and not link.exists():
            raise GlissandoError(
                f"{option} {folder}: {link} is a link that leads nowhere; delete it."
            )
    above = next((p for p in (folder, *folder.absolute().parents) if p.exists()), folder)
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise GlissandoError(f"{option} {folder}: {above} is not a folder that can be written to.")


def require_results_folder(folder: Path) -> None:
    """Make sure, before any work is done, that --out is a folder for results.

    Args:
        folder: The folder, which may not be there yet.

    Raises:
        GlissandoError: If the folder cannot be made or written to, or is a recording, which other
            commands would then take for results.
    """
    require_writable(folder)
    if _is_recording(folder):
        raise GlissandoError(f"--out {folder} is a recording; give a folder for the results.")


def write_robot(document: dict[str, Any], start: str, out: Path) -> None:
    """Write a learned robot file, whole or not at all, with a line that says what it came from.

    Args:
        document: The robot file.
        start: Robot that it began with.
        out: File to write.
    """
    header = f"{LEARNED}{made_by()}, beginning with {start}, without its comments.\n"
    document = {"format": stated_format("robot"), **document}
    write_text(out, header + tomli_w.dumps(document))
