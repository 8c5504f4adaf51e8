"""When the host let a process wait for its turn, measured from outside the test's own process.

One watcher for each processor asks to be woken every 2 ms and notes when it is woken late. Who
sleeps is woken soon even where others compute all the time; how long someone who was ready had to
wait is what Linux counts as pressure.
"""

import os
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

_PERIOD, _LATE = 0.002, 0.010  # s; an idle host wakes a process within a millisecond or two
_BUSY = 0.25  # of the time: someone waits for a processor, more than a test's own few processes do
_WATCH = f"""
import os, sys, time
os.sched_setaffinity(0, {{int(sys.argv[1])}})
last = time.monotonic()
print("ready", flush=True)
while True:
    time.sleep({_PERIOD})
    now = time.monotonic()
    if now - last > {_PERIOD + _LATE}:
        print(last, now, flush=True)
    last = now
"""


class HostStalls:
    """Stretches (begin, end), monotonic s, in which some processor kept a watcher waiting.

    And the share of the time, `waited`, for which some process was ready and had no processor.
    """

    def __init__(self):
        self.stretches, self.waited = [], 0.0

    @property
    def disturbed(self):
        """Whether what keeps time may have failed for the host alone."""
        return bool(self.stretches) or self.waited > _BUSY

    @property
    def longest(self):
        """The longest stall, s."""
        return max((end - begin for begin, end in self.stretches), default=0.0)


@contextmanager
def watched_host():
    """The host's stalls while the context lasts, to be read after it."""
    stalls, pipe, began, before = HostStalls(), subprocess.PIPE, time.monotonic(), _waited()
    processors = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    commands = ([sys.executable, "-I", "-S", "-c", _WATCH, str(one)] for one in processors)
    watchers = [subprocess.Popen(c, stdout=pipe, text=True) for c in commands]
    for watcher in watchers:
        watcher.stdout.readline()
    try:
        yield stalls
    finally:
        for watcher in watchers:
            watcher.kill()
            lines, _ = watcher.communicate()
            whole = [line.split() for line in lines.splitlines(keepends=True) if line[-1:] == "\n"]
            stalls.stretches += [(float(begin), float(end)) for begin, end in whole]
        stalls.stretches.sort()
        stalls.waited = (_waited() - before) / (time.monotonic() - began)


def _waited():
    """For how long some process has waited for a processor so far, s; 0 where nobody counts it."""
    with suppress(OSError, ValueError):
        some = Path("/proc/pressure/cpu").read_text(encoding="ascii").splitlines()[0]
        return 1e-6 * float(some.rpartition("total=")[2])
    return 0.0
