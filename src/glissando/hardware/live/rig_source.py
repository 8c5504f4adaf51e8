"""The devices of a rig, real or simulated, while its slide follows a path.

The rig is read by a process of its own, as `record` reads it, with the same session log: an
estimator beside it would hold the interpreter while a frame or the slide waits.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from glissando.errors import DeviceError, GlissandoError
from glissando.geometry.se3 import Array
from glissando.hardware.capture import Coil, Rig, capture
from glissando.hardware.capture.child_process import blocked_signals, end_with_parent
from glissando.hardware.capture.setup import pose_of
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.placement import reading
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.slide_path import SlidePath

_END = 15.0  # s that the slide may take to stop and the log to be written
_LAST = 2.0  # s that a process which did not end in this time may take to end at once
_LOOK = 0.1  # s between looks whether it has
_MOST = 1024  # messages that one look takes


class RigSource:
    """Readings of a rig's coils, whose arclengths follow the slide.

    Args:
        rig: The devices.
        robot: The robot, which states the noise of coils.
        path: What the slide follows from the beginning; the source finishes at its end.
        folder: New folder for the session log; a temporary one unless given.
        further: Paths of the rig's further stages by name.
        steered: Whether the slide goes where `steer` says, for as long as the path lasts.

    Attributes:
        counts: Messages 'heard', coils 'not seen'.

    Raises:
        DeviceError: A device failed; from `read`.
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
        self.name, self.counts = f"rig {rig.name}", Counter[str]()
        self._rig, self._robot, self._folder = rig, robot, folder
        self._paths = path, dict(further or {})
        self._coils = {f"/tracker/{coil.name}": coil for coil in rig.coils}
        self._travel, self.finished = dict[str, float](), False
        self._steered, self._times = steered, SessionClock()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if self._folder is None:
            self._folder = Path(self._stack.enter_context(TemporaryDirectory())) / "session"
        context = multiprocessing.get_context("spawn")
        self._messages = context.Queue()
        heard, self._steering = context.Pipe(duplex=False)
        steering = heard if self._steered else None
        arguments = self._rig, self._paths, self._folder, self._messages, steering
        self._process = context.Process(target=_capture, args=arguments)
        with blocked_signals():
            self._process.start()
        heard.close()
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
        self._messages.cancel_join_thread()
        self._steering.close()
        self._stack.close()

    def steer(self, time: Array, travel: Array) -> None:
        """Have the slide follow another path from now on; at its end it stands.

        Args:
            time: Session times (K,), s, from before now on.
            travel: Travels (K,) at these times, m, which go on from where the slide is.
        """
        since = self._times.of_monotonic(0.0)
        with suppress(OSError):  # the rig has ended, which `read` says
            self._steering.send((time - since, travel))

    def _drain(self, within: float) -> None:
        """Empty the queue until its end, without which the process does not end."""
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
        """Why nothing comes; empty once messages have."""
        return "" if self.counts["heard"] or self.finished else f"{self.name} is starting"

    def read(self, clock: SessionClock) -> list[Readings]:
        """The readings that have come since the last call."""
        self._times = clock
        out, alive = [], self._process.is_alive()
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
            if topic.startswith("/slide"):
                self._travel[topic] = message["travel"]
            elif topic in self._coils:
                if message["position"] is None:
                    self.counts["not seen"] += 1
                else:
                    out.append(self._reading(self._coils[topic], message, clock))
        return out

    def _reading(self, coil: Coil, message: dict[str, Any], clock: SessionClock) -> Readings:
        travel = np.array([self._travel.get(coil.slide_topic, 0.0)])
        place = float(coil.arclengths(travel, self._robot.length)[0])
        time, seen = clock.of_monotonic(message["time"]), self._rig.frame @ pose_of(message)
        out = reading(self._robot, "coil", coil.name, time, place, seen)
        return replace(out, channel=coil.channel)


def _capture(
    rig: Rig,
    paths: tuple[SlidePath, dict[str, SlidePath]],
    folder: Path,
    messages: Any,
    steering: Connection | None,
) -> None:
    """Run the experiment, pass on its messages, and then how it ended."""
    end: DeviceError | None = None
    signal.signal(signal.SIGTERM, signal.default_int_handler)

    def stop() -> None:
        messages.cancel_join_thread()  # nobody reads them any more
        os.kill(os.getpid(), signal.SIGTERM)

    end_with_parent(stop)
    try:
        capture(
            rig, paths[0], folder, further=paths[1],
            steered=_Steered(steering, rig.standing_travel) if steering else None,
            on_message=lambda *message: messages.put(message),
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
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # all stands; this is still to be said
        if end is not None:
            messages.put(end)
        messages.put(None)


class _Steered:
    """Where the slide is to be by the newest path that came; before the first, where it stands."""

    def __init__(self, paths: Connection, standing: float) -> None:
        self._paths = paths
        self._path = np.zeros(1), np.array([standing])

    def __call__(self, monotonic: float) -> float:
        with suppress(EOFError, OSError):  # nobody steers any more: the last path ends at rest
            while self._paths.poll():
                self._path = self._paths.recv()
        return float(np.interp(monotonic, *self._path))
