"""Entry point of the command line: parses, runs a command, reports errors and the exit status."""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from errno import ENOSPC
from importlib import import_module
from types import FrameType
from typing import Any

from glissando import __version__
from glissando.cli.commands import COMMANDS
from glissando.cli.plugins import add_plugins, import_plugins
from glissando.cli.say import say
from glissando.errors import (
    FalseConfidenceWarning,
    GlissandoError,
    NoShapeError,
    OldNameWarning,
    OtherTimesWarning,
    PlanWarning,
    is_interrupt,
)

_OWN = (OldNameWarning, PlanWarning, FalseConfidenceWarning, OtherTimesWarning)
_AGAIN = 0.05  # s after which a lost interrupt is raised again
_CLEAN_UP = 15.0  # s after a signal in which further ones do not interrupt the clean-up


class _PrintCompletion(argparse.Action):
    """Action that prints a completion script for a shell."""

    def __call__(self, parser: argparse.ArgumentParser, *args: Any, **kwargs: Any) -> None:

        completion = import_module("glissando.cli.completion").completion
        print(completion(build_parser(), args[1]))
        parser.exit()


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Build the parser of the command line.

    Args:
        command: The only command whose module is imported; None for all.
    """
    parser = argparse.ArgumentParser(
        prog="glissando",
        description="Where every part of a continuum robot is, at every moment, and how sure.",
        allow_abbrev=False,  # plugins are imported by the whole word
    )
    parser.add_argument("--version", action="version", version=f"glissando {__version__}")
    add_plugins(parser)
    prints, shells = "print a script that completes words, and exit", ("bash", "zsh", "tcsh")
    parser.add_argument("--print-completion", action=_PrintCompletion, choices=shells, help=prints)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module, summary) in COMMANDS.items():
        if command in (None, name):
            import_module(f"glissando.cli.{module}").add_to(commands)
        else:
            commands.add_parser(name, help=summary)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status.

    Args:
        arguments: Words of the command line; None for those of the process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    _escape_unencodable()
    try:
        with _stopped_by_signals(ends_process=arguments is None), _own_warnings_shown():
            try:
                status = _run(words)
            except SystemExit:  # of --help
                _flush_stdout()
                raise
            except OSError as problem:
                full = problem.errno == ENOSPC and not problem.filename
                _flush_stdout("\n" if full else "")  # fails if it was stdout
                raise
            _flush_stdout()
            return status
    except NoShapeError as problem:
        say(f"glissando: {problem}")
        return 1
    except GlissandoError as problem:
        say(f"glissando: {problem}")
        return 2
    except BrokenPipeError:  # the reader of the output has closed it
        _discard_stdout()
        return 141
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        say(f"glissando: {where}{problem.strerror or problem}")
        return 2
    except MemoryError:
        say(
            "glissando: this needs more memory than there is; choose a shorter time, fewer nodes "
            "in the robot file, or a larger machine."
        )
        return 2
    except (KeyboardInterrupt, SystemError, ImportError) as problem:  # of compiled code
        if not is_interrupt(problem):
            raise
        say("glissando: interrupted")
        return 130


def _run(words: list[str]) -> int:
    """Parse a command line, run its command and return the exit status."""
    others = import_plugins(words)
    command = next((word for word in others if not word.startswith("-")), "")
    options, unknown = build_parser(command).parse_known_args(others)
    if unknown:  # refused with the usage of this command
        options.refuse(f"unrecognized arguments: {' '.join(unknown)}")
    options.words = others
    return int(options.run(options))


def _flush_stdout(last: str = "") -> None:
    """Write what stdout holds, and `last`; raise BrokenPipeError or GlissandoError if it cannot."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.write(last)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as problem:
        _discard_stdout()
        raise GlissandoError(
            f"Standard output cannot be written ({problem.strerror}), so what it was to show is "
            f"lost; send it elsewhere."
        ) from None


def _discard_stdout() -> None:
    """Send what stdout still holds nowhere, so that the exit does not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _escape_unencodable() -> None:
    """Let stdout and stderr escape characters that their encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def _stopped_by_signals(*, ends_process: bool = False) -> Iterator[None]:
    """Raise KeyboardInterrupt at the first Ctrl-C, SIGTERM or SIGHUP, and not during clean-up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    requests: list[float] = []

    def stop(number: int, frame: FrameType | None) -> None:
        requests.append(time.monotonic())
        if len(requests) > 1 and requests[-1] < requests[0] + _CLEAN_UP:
            os.write(2, b"glissando: stopping, as asked; everything is being put away.\n")
            return
        raise KeyboardInterrupt

    def interrupt_again() -> None:
        if hasattr(signal, "pthread_kill"):  # interrupts a sleep, too
            signal.pthread_kill(threading.main_thread().ident or 0, handled[0])
        else:
            signal.raise_signal(handled[0])

    def unraisable(lost: Any) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):  # raised in a destructor: raise it again
            requests.clear()
            threading.Timer(_AGAIN, interrupt_again).start()
        else:
            show_lost(lost)

    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP; nohup leaves it ignored
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    handled = [n for n in numbers if signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, stop) for number in handled}
    show_lost, sys.unraisablehook = sys.unraisablehook, unraisable
    try:
        yield
    finally:
        sys.unraisablehook = show_lost
        for number, handler in before.items():  # ignore signals while the program exits
            signal.signal(number, signal.SIG_IGN if ends_process else handler)


@contextmanager
def _own_warnings_shown() -> Iterator[None]:
    """Show each of the package's own warnings in _OWN once, as a line on stderr."""
    shown: set[str] = set()
    with warnings.catch_warnings():
        show = warnings.showwarning

        def show_line(message: Warning | str, category: type[Warning], *args: Any) -> None:
            if not issubclass(category, _OWN):
                show(message, category, *args)
            elif str(message) not in shown:
                shown.add(str(message))
                say(f"glissando: {message}")

        for category in _OWN:
            warnings.simplefilter("always", category)
        warnings.showwarning = show_line  # type: ignore[assignment]
        yield


if __name__ == "__main__":
    sys.exit(main())
