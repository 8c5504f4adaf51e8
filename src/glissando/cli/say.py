"""What a command says beside its output."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Print a line on stderr at once."""
    print(text, file=sys.stderr, flush=True)
