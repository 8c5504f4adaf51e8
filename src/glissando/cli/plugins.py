"""`glissando --plugin wire.py COMMAND`: user-defined sensors and priors, for every command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from glissando.errors import GlissandoError


def add_plugins(parser: argparse.ArgumentParser) -> None:
    """Add the option --plugin to a parser."""
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="MODULE",
        help="a Python file, or a module, that declares sensors or priors of your own; may be "
        "given several times",
    )


def import_plugins(words: Sequence[str]) -> list[str]:
    """Import the plugins that a command line names, and return its other words.

    The folder of a file is appended to sys.path, so that processes started by the command can
    import it, too.

    Raises:
        GlissandoError: A plugin cannot be imported.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, prog="glissando")
    add_plugins(parser)
    options, others = parser.parse_known_args(words)
    for name in options.plugin:
        path = Path(name)
        if path.suffix == ".py":
            _import_file(path)
        else:
            _import(name, name)
    return others


def _import_file(path: Path) -> None:
    if not path.is_file():
        raise GlissandoError(f"There is no file {path}; correct --plugin.")
    sys.path.append(str(path.resolve().parent))
    module = _import(path.stem, str(path))
    if Path(module.__file__ or "").resolve() != path.resolve():
        raise GlissandoError(
            f"The plugin {path} has the name of another module, {path.stem}; rename the file."
        )


def _import(module: str, name: str) -> ModuleType:
    try:
        return import_module(module)
    except Exception as problem:
        raise GlissandoError(
            f"The plugin {name} cannot be imported ({type(problem).__name__}: {problem}); "
            f"correct it, or --plugin."
        ) from problem
