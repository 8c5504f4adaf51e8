"""One experiment: the slide follows its path while every device is recorded.

One thread per device writes its messages to the session log; a separate process polls the tracker.
The caller's thread drives the slide. However the experiment ends – at the end of the path, by an
exception or by Ctrl-C – the slide is stopped first. The log can be converted to a recording in
the same folder.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.capture.coil_names import name_by_handle, name_by_identity
from glissando.hardware.capture.devices import opened_stage, opened_tracker
from glissando.hardware.capture.messages import (
    MessageLog,
    Progress,
    log_mocap_frame,
    log_slide,
    log_tracker_frame,
)
from glissando.hardware.capture.online import OnMessage
from glissando.hardware.capture.setup import FurtherStage, Rig
from glissando.hardware.drivers import LinearStage, SlideReading, ViconStream
from glissando.io.atomic import renewed_folder
from glissando.io.recording_writer import write_streams
from glissando.io.session_log import RawSession, SessionWriter
from glissando.io.session_recording import LOG, session_streams
from glissando.model.slide_path import SlidePath

_SETTLE = 0.5  # s before the slide moves, in which the tracker's clock converges
_PATIENCE = 0.5  # s to wait for a device before checking whether the experiment has ended
_PATH_STEP = 0.01  # s, largest interval between the points of a path given to the stage


OnProgress = Callable[[Progress], None]
"""Called many times a second during the experiment."""


def capture(
    rig: Rig,
    path: SlidePath,
    folder: Path,
    *,
    further: Mapping[str, SlidePath] | None = None,
    steered: Callable[[float], float] | None = None,
    on_progress: OnProgress | None = None,
    on_message: OnMessage | None = None,
) -> Progress:
    """Run an experiment and log it; a crash loses at most the last second of the log.

    Args:
        rig: The devices.
        path: Path of the slide.
        folder: New folder for the log.
        further: Paths of the rig's further stages by name; `path` for stages without an entry.
        steered: Function that returns the desired travel, m, at a time.monotonic(), s. If given,
            the slide follows it, and `path` determines only the duration.
        on_progress: Called with the progress from the caller's thread.
        on_message: Called with each message after it is logged, from the devices' threads.

    Returns:
        The progress at the end.

    Raises:
        DeviceError: A device failed. Earlier messages are in the log, and the slide is at rest.
    """
    try:
        folder.mkdir(parents=True, exist_ok=False)
    except FileExistsError:
        raise DeviceError(f"{folder} exists; give a new folder for the session.") from None
    progress, metadata = Progress(total=path.duration), {"setup": json.dumps(rig.described())}
    with SessionWriter(folder / LOG, metadata) as writer:
        log = MessageLog(writer, progress, on_message)
        moving = closing(_experiment(rig, path, steered, log))
        with _recording_threads(rig, path, further or {}, log) as failures, moving as steps:
            for _ in steps:
                if failures:
                    break
                if on_progress is not None:
                    on_progress(progress)
    return progress


@contextmanager
def _recording_threads(
    rig: Rig, path: SlidePath, further: Mapping[str, SlidePath], log: MessageLog
) -> Iterator[list[BaseException]]:
    """Record all devices but the first stage in threads; raise their first failure at the end."""
    over, failures = threading.Event(), list[BaseException]()
    with ExitStack() as stack:
        steps = _steps(rig, path, further, log, stack)
        threads = [threading.Thread(target=_repeat, args=(s, over, failures)) for s in steps]
        driven = [step for step in steps if isinstance(step, _Driven)]
        stack.callback(_finish, over, threads, driven)
        for thread in threads:
            thread.start()
        yield failures
    if failures:
        raise failures[0]


def _steps(
    rig: Rig, path: SlidePath, further: Mapping[str, SlidePath], log: MessageLog, stack: ExitStack
) -> list[Callable[[], None]]:
    """Open all devices but the first stage on `stack`; returns functions that log one message."""
    steps: list[Callable[[], None]] = []
    if rig.tracker is not None:
        tracker = stack.enter_context(opened_tracker(rig, rig.tracker))
        names = name_by_identity(tracker.tools, name_by_handle(tracker.tools, rig.coils))
        steps.append(lambda: log_tracker_frame(tracker, names, log, _PATIENCE))
    if rig.mocap is not None:
        mocap = stack.enter_context(ViconStream(rig.mocap, host=rig.mocap_host, timeout=_PATIENCE))
        steps.append(lambda: log_mocap_frame(mocap, rig, log))
    for stage in rig.further:
        driven = _Driven(stage, further.get(stage.name, path), log)
        stack.callback(driven.close)
        steps.append(driven)
    return steps


def _repeat(step: Callable[[], None], over: threading.Event, failures: list[BaseException]) -> None:
    while not over.is_set() and not failures:
        try:
            step()
        except BaseException as problem:  # raised again by the thread that drives the slide
            if not over.is_set():  # else it was aborted
                failures.append(problem)


def _finish(over: threading.Event, threads: list[threading.Thread], driven: list[_Driven]) -> None:
    """End the threads, and abort a further stage that still homes or moves to its start."""
    over.set()
    for one in driven:
        one.abort()
    for thread in threads:
        thread.join()


def _experiment(
    rig: Rig, path: SlidePath, steered: Callable[[float], float] | None, log: MessageLog
) -> Generator[None, None, None]:
    """Run the steps of the experiment: let clocks converge, home, follow the path."""
    progress = log.progress
    yield from _wait(_SETTLE)
    progress.began, progress.count = time.monotonic(), Counter()
    if rig.slide is None or rig.stage is None:
        yield from _wait(path.duration)
        return
    with opened_stage(rig.slide, rig.stage) as slide:
        _home(slide, rig.standing)
        for reading in _motion(slide, path, steered):
            log_slide(reading, log, "")
            yield
        progress.problems.update({f"slide {k}": str(n) for k, n in slide.counts.items() if n})


def _motion(
    slide: LinearStage, path: SlidePath, steered: Callable[[float], float] | None
) -> Iterator[SlideReading]:
    """Readings of a stage that follows a path, or the function `steered` for the same duration."""
    if steered is not None:
        begun = time.monotonic()
        return slide.pursue(lambda into: steered(begun + into), path.duration)
    points = max(2, math.ceil(path.duration / _PATH_STEP) + 1)
    times = np.linspace(0.0, path.duration, points)
    return slide.follow(times, path.at(times))


def _home(slide: LinearStage, standing: float | None) -> None:
    if standing is None:
        slide.home_at_stop()
    else:
        slide.home_here(standing)


class _Driven:
    """A further stage on its path: each call logs its next reading, and the first one opens it."""

    def __init__(self, one: FurtherStage, path: SlidePath, log: MessageLog) -> None:
        self._name, self._log, self._aborted = one.name, log, False
        self._slide: LinearStage | None = None
        self._readings = self._follow(one, path)

    def __call__(self) -> None:
        log_slide(next(self._readings), self._log, self._name)

    def abort(self) -> None:
        """End a motion that the stage's thread waits for, or prevent one that has not begun."""
        self._aborted = True
        if self._slide is not None:
            self._slide.abort()

    def close(self) -> None:
        """Stop the stage and close it."""
        self._readings.close()

    def _follow(self, one: FurtherStage, path: SlidePath) -> Generator[SlideReading, None, None]:
        with opened_stage(one.address, one.stage) as slide:
            self._slide = slide
            if self._aborted:  # while it was opened
                return
            _home(slide, one.standing)
            yield from _motion(slide, path, None)
            while True:  # the first may still move
                yield slide.read()
                time.sleep(_PATH_STEP)


def _wait(seconds: float) -> Iterator[None]:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.02)
        yield


def write_recording(session: RawSession, rig: Rig, folder: Path) -> list[str]:
    """Write a session log as a recording.

    Args:
        session: The session log.
        rig: The rig that was logged.
        folder: Folder of the recording.

    Returns:
        Warnings about bodies that were never visible, and about gaps.

    Raises:
        RecordingError: No stream has any readings.
    """
    recorded = session_streams(session, rig.described())
    with renewed_folder(folder, ()) as building:
        frames = {"tracker": recorded.frame}
        write_streams(
            building, recorded.name, recorded.streams, robot=recorded.robot, frames=frames
        )
    return recorded.warnings
