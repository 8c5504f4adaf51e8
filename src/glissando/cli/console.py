"""The console that commands print on."""

from __future__ import annotations

from rich.console import Console as RichConsole


class Console(RichConsole):
    """A console which leaves it to `main` to end when nobody reads on."""

    def on_broken_pipe(self) -> None:
        """Raise what Rich would answer with an exit."""
        raise BrokenPipeError
