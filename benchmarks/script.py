"""What scripts share: a mistake is one sentence and status 2, and work of some length says so."""

import sys
import time
from pathlib import Path

from glissando import GlissandoError

EVERY = 5.0  # seconds between lines on stderr

_said = [time.monotonic()]


def run(main):
    """Run a script; what was given wrongly is said in a sentence."""
    try:
        status = main()
    except (GlissandoError, OSError) as problem:
        print(f"{Path(sys.argv[0]).name}: {problem}", file=sys.stderr)
        status = 2
    raise SystemExit(status)


def say(text):
    """Say how far work is, on stderr and every few seconds at most."""
    if time.monotonic() - _said[0] > EVERY:
        _said[0] = time.monotonic()
        print(text, file=sys.stderr, flush=True)
