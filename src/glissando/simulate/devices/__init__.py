"""Simulated devices, each in a process of its own, spoken to in the words of the real one."""

from __future__ import annotations

import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from glissando.errors import DeviceError


@contextmanager
def started(module: str, *arguments: str, timeout: float = 10.0) -> Iterator[str]:
    """Run a simulated device while the block lasts; gives the address that it prints.

    `module` is a module of this package, `arguments` are its command line's. Raises DeviceError
    when no address comes within `timeout` seconds.
    """
    command = [sys.executable, "-m", f"glissando.simulate.devices.{module}", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            assert process.stdout is not None
            ready, _, _ = select.select([process.stdout], [], [], timeout)
            address = process.stdout.readline().strip() if ready else ""
            if not address:
                raise DeviceError(
                    f"The simulated {module} printed no address within {timeout:g} s; run "
                    f"{' '.join(command[1:])} by hand to see why."
                )
            yield address
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
