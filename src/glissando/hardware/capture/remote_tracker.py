"""A tracker that a separate process reads, so that nothing delays the next request.

A thread would share the interpreter lock with the slide, the log and the progress table, and a
frame that is not requested within its 25 ms is lost.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from glissando.errors import DeviceError
from glissando.hardware.capture.child_process import blocked_signals
from glissando.hardware.drivers import Aurora
from glissando.hardware.drivers.aurora_reply import Frame
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.hardware.drivers.link import DeviceTimeoutError

_PATIENCE = 0.5  # s without a frame after which the process checks whether the pipe is closed
_START, _END = 60.0, 5.0  # s allowed for the process and its tracker to start, and to end


class RemoteTracker:
    """Frames of a tracker, received from the process that reads it.

    Times are of the monotonic clock, which all processes of a host share.

    Attributes:
        tools: Coils that are plugged in at present.
        counts: Number of communication problems and frames, by name.
    """

    def __init__(self, pipe: Connection, tools: list[Tool]) -> None:
        self._pipe, self.tools, self.counts = pipe, tools, dict[str, int]()

    def read(self, timeout: float) -> Frame | None:
        """Wait for the next frame; None after a timeout.

        Args:
            timeout: Seconds to wait.

        Raises:
            DeviceError: The tracker failed, or its process ended.
        """
        if not self._pipe.poll(timeout):
            return None
        frame: Frame | None
        frame, self.tools, self.counts = _receive(self._pipe)
        return frame


@contextmanager
def remote_tracker(address: str, baud: int) -> Iterator[RemoteTracker]:
    """Start a process that reads a tracker while the context lasts.

    Args:
        address: Serial path, or tcp://host:port.
        baud: Rate of a serial line.

    Raises:
        DeviceError: As `Aurora` raises it, or the process does not start.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(address, baud, theirs), daemon=True)
    with blocked_signals():
        process.start()
    theirs.close()
    try:
        if not ours.poll(_START):
            raise DeviceError(f"The process that reads {address} did not start; start it again.")
        yield RemoteTracker(ours, _receive(ours))
    finally:
        ours.close()
        process.join(_END)
        if process.is_alive():
            process.terminate()
            process.join()


def _receive(pipe: Connection) -> Any:
    try:
        message = pipe.recv()
    except (EOFError, OSError):
        raise DeviceError("The process that reads the tracker has ended; record again.") from None
    if isinstance(message, DeviceError):
        raise message
    return message


def _serve(address: str, baud: int, pipe: Connection) -> None:
    """Send the tools, then frames with tools and counts, until the pipe is closed."""
    with suppress(BrokenPipeError, ConnectionError, EOFError):
        try:
            with Aurora(address, baud=baud) as tracker:
                pipe.send(tracker.tools)
                while not pipe.poll():
                    frame = None
                    with suppress(DeviceTimeoutError):
                        frame = tracker.read(_PATIENCE)
                    pipe.send((frame, tracker.tools, dict(tracker.counts)))
        except DeviceError as problem:
            pipe.send(DeviceError(str(problem)))  # its subclasses may not survive pickling
