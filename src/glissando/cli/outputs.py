"""Outputs of commands: checks that they replace no data, and the provenance that reports state."""

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
    """Require, before any work is done, that a file to write does not replace data.

    Args:
        option: Option that names the file, such as --out.
        out: File to write.
        inputs: Files and folders that the command reads; None for one that is not given.
        begins: First characters of files that the command writes; if given, an existing file is
            replaced only if it begins with one of them.

    Raises:
        GlissandoError: The file is one of the inputs, a data file in one of them or in a recording,
            or is not one that this command writes.
    """
    if not out.exists():
        return
    real, given = out.resolve(), [Path(each).resolve() for each in inputs if each is not None]
    in_recording = any(
        folder in given or _is_recording(folder) for folder in (real.parent, out.parent.resolve())
    )
    if real in given or (in_recording and real.suffix in _DATA):
        raise GlissandoError(f"{option} {out} would replace data; give another name or folder.")
    if begins and real.is_file():
        with real.open(encoding="utf-8", errors="replace") as file:
            start = file.read(max(map(len, begins)))
        if start and not start.startswith(tuple(begins)):
            raise GlissandoError(
                f"{option} {out} is there and none that this command writes; give another name, "
                f"or delete it first."
            )


def _is_recording(folder: Path) -> bool:
    """Whether a folder has a recording.toml, a session log or streams of the public layout."""
    described = any((folder / name).is_file() for name in (_TOML, LOG))
    return described or any(is_public(file) for file in folder.glob("*.csv"))


def stated(options: argparse.Namespace, robot: Robot | None = None) -> dict[str, Any]:
    """Provenance in a report, for `glissando rerun`: command line and digests of the inputs.

    Args:
        options: Options of the command.
        robot: Robot used, which may be that of the recording.

    Returns:
        `request`, the words after `glissando` without --out; `inputs`, the SHA-256 of every file
        that an option names, by option, and of the files in every such folder, by file name;
        `seed`, if the command has one.
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
    """Words of a command without `--out DIR`, so that reports do not depend on the folder."""
    kept, remaining = [], iter(words)
    for word in remaining:
        flag, equals, _ = word.partition("=")
        if not (len(flag) > 2 and "--out".startswith(flag)):
            kept.append(word)
        elif not equals:
            next(remaining)
    return kept


def _digests_of(path: Path, option: str) -> dict[str, str]:
    if path.is_file():
        return {option: next(iter(digests([path]).values()))}
    kinds = (".csv", ".mcap", ".toml", ".nc")
    return digests(file for file in sorted(path.iterdir()) if file.suffix in kinds)


def require_writable(folder: Path, option: str = "--out") -> None:
    """Require, before any work is done, that results can be written into a folder.

    Args:
        folder: Folder, which may not exist yet.
        option: Option that names the folder, or a file in it.

    Raises:
        GlissandoError: The folder cannot be created or written to.
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
    """Require, before any work is done, that --out is a folder for results.

    Args:
        folder: Folder, which may not exist yet.

    Raises:
        GlissandoError: The folder cannot be created or written to, or is a recording, which other
            commands would then take for results.
    """
    require_writable(folder)
    if _is_recording(folder):
        raise GlissandoError(f"--out {folder} is a recording; give a folder for the results.")


def write_robot(document: dict[str, Any], start: str, out: Path) -> None:
    """Write a learned robot file, whole or not at all, with a comment on its origin.

    Args:
        document: Document of the robot file.
        start: Name or file of the robot from which learning started.
        out: File to write.
    """
    header = f"{LEARNED}{made_by()}, beginning with {start}, without its comments.\n"
    document = {"format": stated_format("robot"), **document}
    write_text(out, header + tomli_w.dumps(document))
