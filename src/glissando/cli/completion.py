"""`glissando --print-completion SHELL`: a completion script for a shell, made by shtab."""

from __future__ import annotations

import argparse
from pathlib import Path

import shtab

from glissando.io.shipped_robots import shipped_robots

_ROBOTS = {
    "bash": '_glissando_robots() { compgen -W "@" -- $1; compgen -f -- $1; }',
    "zsh": "_glissando_robots() { compadd @; _files; }",
}


def completion(parser: argparse.ArgumentParser, shell: str) -> str:
    """Text of a shell script that completes commands, options, robots and files.

    Args:
        parser: Parser of the whole command line.
        shell: Name of the shell: bash, zsh or tcsh.
    """
    (commands,) = (a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    for command in commands.values():
        for action in command._actions:
            if action.dest == "robot":
                action.complete = dict.fromkeys(_ROBOTS, "_glissando_robots")
            elif action.type is Path:
                action.complete = shtab.FILE
    robots = " ".join(shipped_robots())
    preamble = _ROBOTS.get(shell, "").replace("@", robots)
    return str(shtab.complete(parser, shell, preamble=preamble))
