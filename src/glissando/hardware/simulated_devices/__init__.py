"""Simulated devices: separate processes that implement the wire protocols of real ones.

`python -m glissando.hardware.simulated_devices.NAME …` runs one, prints its address as one line
when it is ready, and ends when its standard input closes or on SIGTERM.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from typing import IO, Any

from glissando.errors import SimulationError

_END = 5.0  # s allowed for a device to end by itself


@contextlib.contextmanager
def started(name: str, *options: str | os.PathLike[str], within: float = 60.0) -> Iterator[str]:
    """Run a simulated device while the context lasts; the context yields its address.

    Args:
        name: Name of its module in this package.
        options: Arguments of its command line.
        within: Seconds allowed for it to become ready.

    Raises:
        SimulationError: The device does not become ready; the message ends with its last output.
    """
    command = [sys.executable, "-m", f"{__name__}.{name}", *(os.fspath(one) for one in options)]
    with tempfile.TemporaryFile() as errors:
        pipe = subprocess.PIPE
        streams: dict[str, Any] = {"stdin": pipe, "stdout": pipe, "stderr": errors}
        # In a session of its own, so that Ctrl-C at the terminal does not reach the device.
        with subprocess.Popen(command, **streams, start_new_session=True) as process:
            try:
                yield _first_line(process, errors, name, within)
            finally:
                assert process.stdin is not None
                with contextlib.suppress(OSError):
                    process.stdin.close()
                try:
                    process.wait(_END)
                except subprocess.TimeoutExpired:
                    process.kill()


def _first_line(
    process: subprocess.Popen[bytes], errors: IO[bytes], name: str, within: float
) -> str:
    assert process.stdout is not None
    slow = threading.Timer(within, process.kill)  # bounds the wait for the first line
    slow.start()
    line = process.stdout.readline().decode().strip()
    slow.cancel()
    if not line:
        process.wait()
        errors.seek(0)
        output = errors.read().decode(errors="replace").strip().splitlines() or ["no output"]
        raise SimulationError(f"The simulated {name} did not start: {output[-1]}")
    return line
