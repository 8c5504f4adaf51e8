"""When the host let a process wait for its turn, measured by processes that do nothing else.

One watcher for each processor asks to be woken every 2 ms and notes when it is woken late. They are
no threads of the test's own process, so that waiting for the interpreter is no stall of the host.
"""

import os
import subprocess
import sys
from contextlib import contextmanager

_PERIOD, _LATE = 0.002, 0.010  # s; an idle host wakes a process within a millisecond or two
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
    """Stretches (begin, end), monotonic s, in which some processor kept a watcher waiting."""

    def __init__(self):
        self.stretches = []

    @property
    def longest(self):
        """The longest stall, s."""
        return max((end - begin for begin, end in self.stretches), default=0.0)


@contextmanager
def watched_host():
    """The host's stalls while the context lasts, to be read after it."""
    stalls, pipe = HostStalls(), subprocess.PIPE
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
