"""The command line: parses, runs a command, turns mistakes into one sentence and a status."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from glissando import __version__
from glissando.cli import (
    calibrate,
    check,
    design,
    doctor,
    estimate,
    exporting,
    importing,
    learn,
    plan,
    record,
    replay,
    report,
    reproduce,
    simulate,
    study,
    view,
)
from glissando.cli.completion import PrintCompletion
from glissando.errors import GlissandoError
from glissando.simulation import NoShapeError

_COMMANDS = (
    *(estimate, check, learn, replay, simulate, plan, design, study, view, report),
    *(record, calibrate, importing, exporting, doctor, reproduce),
)


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog="glissando",
        description="Where every part of a continuum robot is, at every moment, and how sure.",
    )
    parser.add_argument("--version", action="version", version=f"glissando {__version__}")
    told = "print a script that completes words, and exit"
    shells = ("bash", "zsh")
    parser.add_argument("--print-completion", action=PrintCompletion, choices=shells, help=told)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_to(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns its exit status."""
    options = build_parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except NoShapeError as problem:
        print(f"glissando: {problem}", file=sys.stderr)
        return 1
    except GlissandoError as problem:
        print(f"glissando: {problem}", file=sys.stderr)
        return 2
    except OSError as problem:
        print(f"glissando: {problem.filename or ''}: {problem.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("glissando: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
