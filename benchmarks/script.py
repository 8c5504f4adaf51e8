"""Common functions of scripts: errors of use in one sentence with status 2, and progress."""

import sys
import time
from pathlib import Path

from glissando import GlissandoError

EVERY = 5.0  # seconds between lines on stderr

_said = [time.monotonic()]


def run(main):
    """Run a script; errors of the package are printed as one sentence, with status 2."""
    try:
        status = main()
    except (GlissandoError, OSError) as problem:
        print(f"{Path(sys.argv[0]).name}: {problem}", file=sys.stderr)
        status = 2
    raise SystemExit(status)


def say(text):
    """Print progress on stderr, at most every few seconds."""
    if time.monotonic() - _said[0] > EVERY:
        _said[0] = time.monotonic()
        print(text, file=sys.stderr, flush=True)
