"""The tracker is read in a process of its own, where nothing keeps it from asking in time.

In a thread it would wait for the interpreter, which the slide, the log and the table take by turns:
a frame that is not asked for within its 25 ms is gone.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from glissando.errors import DeviceError
from glissando.hardware.drivers import Aurora
from glissando.hardware.drivers.aurora_reply import Frame
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.hardware.drivers.link import SilentError

_PATIENCE = 0.5  # s without a frame after which one looks whether anybody still listens
_START, _END = 60.0, 5.0  # s that the process may take to begin, beside the tracker's, and to end


class Listening:
    """Frames of a tracker as another process reads them.

    `tools` are the coils plugged in now, `counts` what was not as it should be. Times are of the
    monotonic clock, which all processes of a host share.
    """

    def __init__(self, pipe: Connection, tools: list[Tool]) -> None:
        self._pipe, self.tools, self.counts = pipe, tools, dict[str, int]()

    def read(self, timeout: float) -> Frame | None:
        """The next frame, None when none came within `timeout` s. Raises DeviceError."""
        if not self._pipe.poll(timeout):
            return None
        said = _received(self._pipe)
        self.tools, self.counts = said[1], said[2]
        frame: Frame | None = said[0]
        return frame


@contextmanager
def listening(address: str, baud: int) -> Iterator[Listening]:
    """A tracker that is read while the context lasts. Raises DeviceError as `Aurora` does."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_listen, args=(address, baud, theirs), daemon=True)
    with _uninterrupted():
        process.start()
    theirs.close()
    try:
        if not ours.poll(_START):
            raise DeviceError(f"The process that reads {address} did not start; start it again.")
        yield Listening(ours, _received(ours))
    finally:
        ours.close()
        process.join(_END)
        if process.is_alive():
            process.terminate()
            process.join()


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """A process that is started here never hears of Ctrl-C: who started it ends it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _received(pipe: Connection) -> Any:
    try:
        said = pipe.recv()
    except (EOFError, OSError):
        raise DeviceError("The process that reads the tracker has ended; record again.") from None
    if isinstance(said, DeviceError):
        raise said
    return said


def _listen(address: str, baud: int, pipe: Connection) -> None:
    """Send the tools, then frames with tools and counts, until the pipe is closed."""
    with suppress(BrokenPipeError, ConnectionError, EOFError):
        try:
            with Aurora(address, baud=baud) as tracker:
                pipe.send(tracker.tools)
                while not pipe.poll():
                    frame = None
                    with suppress(SilentError):
                        frame = tracker.read(_PATIENCE)
                    pipe.send((frame, tracker.tools, dict(vars(tracker.counts))))
        except DeviceError as problem:
            pipe.send(DeviceError(str(problem)))  # others may not come through the pipe whole
