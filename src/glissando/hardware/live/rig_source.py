"""Readings of a rig's real or simulated devices while its slide follows a path.

A separate process reads the rig, as `record` does, and writes the same session log: an estimator
in the same process would hold the interpreter lock and delay frames and commands to the slide.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import re
import signal
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from glissando.errors import DeviceError, GlissandoError
from glissando.geometry.se3 import Array
from glissando.hardware.capture import Rig, capture
from glissando.hardware.capture.child_process import blocked_signals, end_with_parent
from glissando.hardware.capture.coil_frames import CoilFrames
from glissando.hardware.capture.setup import slide_topic
from glissando.hardware.live.clock import SessionClock
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.slide_path import SlidePath

_END = 15.0  # s allowed for the slide to stop and the log to be written
_LAST = 2.0  # s allowed for the process to end after SIGTERM, before it is killed
_LOOK = 0.1  # s between checks whether the process has ended
_MOST = 1024  # messages per call of `read`
_WANTED = re.compile("/(tracker|slide)").match  # topics from which readings are made


class RigSource:
    """Readings of a rig's coils, at arclengths that follow the slide.

    Args:
        rig: The devices.
        robot: The robot, which defines the noise of coils.
        path: Path of the slide from the start; the source finishes at its end.
        folder: New folder for the session log; a temporary one if None.
        further: Paths of the rig's further stages by name.
        steered: Whether the slide follows the paths given to `steer`, for the duration of `path`.

    Attributes:
        counts: Messages 'heard', and what `CoilFrames` counts.

    Raises:
        DeviceError: A device failed; raised by `read`.
    """

    first: float | None = None
    clock = None

    def __init__(
        self,
        rig: Rig,
        robot: Robot,
        path: SlidePath,
        folder: Path | None = None,
        *,
        further: Mapping[str, SlidePath] | None = None,
        steered: bool = False,
    ) -> None:
        if "coil" not in robot.sensor_std:
            raise DeviceError(f"Robot {robot.name!r} states no noise of coils; add [sensors.coil].")
        self.name, self._rig, self._folder = f"rig {rig.name}", rig, folder
        self._frames = CoilFrames(rig, robot)
        self.counts, self.finished = self._frames.counts, False
        stages = [*([""] if rig.slide else []), *(one.name for one in rig.further)]
        self._homing = {slide_topic(name) for name in stages}  # until their first reading
        self._paths = path, dict(further or {})
        self._steered, self._session_clock = steered, SessionClock()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if self._folder is None:
            self._folder = Path(self._stack.enter_context(TemporaryDirectory())) / "session"
        context = multiprocessing.get_context("spawn")
        self._messages = context.Queue()
        self._steering = context.Queue()  # a pipe would make `steer` wait while the slide homes
        steering = self._steering if self._steered else None
        arguments = self._rig, self._paths, self._folder, self._messages, steering
        self._process = context.Process(target=_capture, args=arguments)
        with blocked_signals():
            self._process.start()
        return self

    def __exit__(self, *raised: object) -> None:
        if self._process.is_alive() and self._process.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(self._process.pid, signal.SIGTERM)  # stops the slide first
        self._drain(_END)
        self._process.join(_END)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(_LAST)
            self._process.kill()
        for messages in (self._messages, self._steering):
            messages.cancel_join_thread()
        self._stack.close()

    def steer(self, time: Array, travel: Array) -> None:
        """Replace the path of the slide, which stops at the end of the new one.

        Args:
            time: Session times (K,), s; the first is before the present.
            travel: Travels (K,) at these times, m, continuous with the present travel.
        """
        self._steering.put((time - self._session_clock.of_monotonic(0.0), travel))

    def _drain(self, within: float) -> None:
        """Empty the queue up to its end mark; the process cannot end before."""
        end = time.monotonic() + within
        while not self.finished and time.monotonic() < end:
            alive = self._process.is_alive()
            try:
                self.finished = self._messages.get(timeout=_LOOK) is None
            except queue.Empty:
                if not alive:
                    return

    @property
    def problem(self) -> str:
        """Reason why no readings arrive; empty once messages of every stage have arrived."""
        if self.finished:
            return ""
        if not self.counts["heard"]:
            return f"{self.name} is starting"
        return f"a stage of {self.name} homes" if self._homing else ""

    @property
    def busy(self) -> bool:
        """Whether a stage homes or moves to the start of its path, which may take long."""
        return bool(self._homing) and not self.finished

    def poll(self) -> None:
        """Do nothing: the queue has no size limit."""

    def read(self, clock: SessionClock) -> list[Readings]:
        """Readings that have arrived since the last call."""
        self._session_clock = clock
        out: list[Readings] = []
        alive = self._process.is_alive()
        for _ in range(_MOST):
            try:
                item = self._messages.get_nowait()
            except queue.Empty:
                if not (alive or self.finished):
                    self.finished = True
                    raise DeviceError(
                        f"The process that reads {self.name} has ended (exit status "
                        f"{self._process.exitcode}); see what it printed, and start again."
                    ) from None
                break
            if item is None or isinstance(item, DeviceError):
                self.finished = True
                if item is not None:
                    raise item
                break
            topic, message = item
            self.counts["heard"] += 1
            self._homing.discard(topic)
            for reading in self._frames.take(topic, message):
                time = clock.of_monotonic(float(reading.time[0]))
                out.append(reading.changed(time=np.array([time])))
        return out


def _capture(
    rig: Rig,
    paths: tuple[SlidePath, dict[str, SlidePath]],
    folder: Path,
    messages: Any,
    steering: Any,
) -> None:
    """Run the capture, put its messages into the queue, and at the end its error, if any."""
    end: DeviceError | None = None
    signal.signal(signal.SIGTERM, signal.default_int_handler)

    def stop() -> None:
        messages.cancel_join_thread()  # the reader has ended
        os.kill(os.getpid(), signal.SIGTERM)

    end_with_parent(stop)
    try:
        capture(
            rig, paths[0], folder, further=paths[1],
            steered=_NewestPath(steering, rig.standing_travel) if steering else None,
            on_message=lambda *message: _WANTED(message[0]) and messages.put(message),
        )  # fmt: skip
    except KeyboardInterrupt:
        pass
    except GlissandoError as problem:
        end = DeviceError(str(problem))  # its subclasses may not survive pickling
    except OSError as problem:
        end = DeviceError(f"The rig cannot be read into {folder} ({problem}); check the disk.")
    except BaseException as problem:
        end = DeviceError(f"The process that reads the rig has failed ({problem!r}).")
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the stages are at rest; report the end
        if end is not None:
            messages.put(end)
        messages.put(None)


class _NewestPath:
    """Travel along the newest path received; before the first one, the standing travel."""

    def __init__(self, paths: Any, standing: float) -> None:
        self._paths = paths
        self._path = np.zeros(1), np.array([standing])

    def __call__(self, monotonic: float) -> float:
        with suppress(queue.Empty):
            while True:
                self._path = self._paths.get_nowait()
        return float(np.interp(monotonic, *self._path))
