"""Simulated devices: each a process of its own that speaks its device's bytes.

`python -m glissando.hardware.simulated_devices.NAME …` runs one, prints its address as one line
when it is ready, and ends when its standard input closes or it is told to terminate.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from typing import IO

from glissando.errors import SimulationError

_END = 5.0  # s that a device has to end by itself


@contextlib.contextmanager
def started(name: str, *options: str | os.PathLike[str], within: float = 60.0) -> Iterator[str]:
    """A simulated device that runs while the context lasts; gives its address.

    `name` is its module here, `options` its command line. Raises SimulationError with what it
    said when it does not become ready `within` seconds.
    """
    command = [sys.executable, "-m", f"{__name__}.{name}", *(os.fspath(one) for one in options)]
    with tempfile.TemporaryFile() as said:
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=said)
        try:
            yield _ready(process, said, name, within)
        finally:
            _end(process)


def _ready(process: subprocess.Popen[bytes], said: IO[bytes], name: str, within: float) -> str:
    assert process.stdout is not None
    slow = threading.Timer(within, process.kill)  # ends the wait for a line that never comes
    slow.start()
    line = process.stdout.readline().decode().strip()
    slow.cancel()
    if not line:
        process.wait()
        said.seek(0)
        last = said.read().decode(errors="replace").strip().splitlines() or ["it said nothing"]
        raise SimulationError(f"The simulated {name} did not start: {last[-1]}")
    return line


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
    try:
        process.wait(_END)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()
