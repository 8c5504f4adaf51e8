"""The console that commands print on."""

from __future__ import annotations

import os
from typing import Any

from rich.console import Console as RichConsole

_WIDE = 10_000  # columns of a file or a pipe, so that no line is cut


class Console(RichConsole):
    """A console which leaves it to `main` to end when nobody reads on.

    What is no terminal gets whole lines, unless the environment says how wide they may be.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if not self.is_terminal and "COLUMNS" not in os.environ:
            self.width = _WIDE

    def on_broken_pipe(self) -> None:
        """Raise what Rich would answer with an exit."""
        raise BrokenPipeError
