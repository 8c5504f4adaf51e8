"""One experiment: the slide follows its path while every device is recorded.

Each device has a thread that writes its messages to the session log; the tracker has a process that
polls it, too. The caller's thread drives the slide. Whatever ends the experiment – its end, an
exception, Ctrl-C – stops the slide first.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.hardware.capture.devices import opened_stage, opened_tracker
from glissando.hardware.capture.online import OnMessage
from glissando.hardware.capture.setup import (
    Coil,
    FurtherStage,
    Rig,
    pose_entries,
    slide_topic,
)
from glissando.hardware.drivers import LinearStage, SlideReading, Tracker, ViconStream
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.io.session_log import INTEGER, NUMBER, SessionWriter, numbers, schema
from glissando.io.session_recording import LOG
from glissando.model.slide_path import SlidePath

_POSE = {"position": numbers(3), "quaternion": numbers(4)}
_TRACKER = schema(
    "glissando.Coil", time=NUMBER, frame=INTEGER, **_POSE, error=NUMBER, status=INTEGER
)
_SLIDE = schema("glissando.Slide", time=NUMBER, tick=NUMBER, travel=NUMBER, speed=NUMBER)
_MOCAP = schema("glissando.Body", time=NUMBER, frame=INTEGER, **_POSE)
_PATIENCE = 0.5  # s to wait for a device before looking whether the experiment is over
_SETTLE = 0.5  # s before the slide moves, in which the tracker's clock converges
_PATH_STEP = 0.01  # s at most between the points of a path given to the stage


@dataclass
class Progress:
    """State of a running experiment.

    Attributes:
        began: When its messages are counted from, monotonic s.
        count: Messages so far, by topic.
        last: The last message of each topic, as text.
        problems: What went wrong, as text, by device.
        total: Duration of the slide's path, s.
    """

    began: float = field(default_factory=time.monotonic)
    count: Counter[str] = field(default_factory=Counter)
    last: dict[str, str] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    total: float = 0.0

    def rate(self, topic: str) -> float:
        """Messages a second since the beginning."""
        return self.count[topic] / max(time.monotonic() - self.began, 1e-9)


OnProgress = Callable[[Progress], None]
"""Called many times a second while the experiment runs."""


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
    """Run an experiment and log it; a crash costs at most the log's last second.

    Args:
        rig: The devices.
        path: What the slide follows.
        folder: New folder for the log.
        further: Paths of the rig's further stages by name; by default the same as the first.
        steered: Where the slide is to be, m, at a time.monotonic(), s, decided on the way; then
            the path states for how long only.
        on_progress: Shows the progress, from the caller's thread.
        on_message: Takes each message after it is logged, from the devices' threads.

    Returns:
        The progress at the end.

    Raises:
        DeviceError: A device failed. What came before is in the log, and the slide stands still.
    """
    folder.mkdir(parents=True, exist_ok=False)
    progress, metadata = Progress(total=path.duration), {"setup": json.dumps(rig.described())}
    with SessionWriter(folder / LOG, metadata) as writer:
        log = _Log(writer, progress, on_message)
        moving = closing(_experiment(rig, path, steered, log))
        with _recorded(rig, path, further or {}, log) as failures, moving as steps:
            for _ in steps:
                if failures:
                    break
                if on_progress is not None:
                    on_progress(progress)
    return progress


@contextmanager
def _recorded(
    rig: Rig, path: SlidePath, further: Mapping[str, SlidePath], log: _Log
) -> Iterator[list[BaseException]]:
    """Threads record all but the first stage; what fails is raised at the end."""
    over, failures = threading.Event(), list[BaseException]()
    with ExitStack() as stack:
        steps = _steps(rig, path, further, log, stack)
        threads = [threading.Thread(target=_repeat, args=(s, over, failures)) for s in steps]
        stack.callback(_finish, over, threads)
        for thread in threads:
            thread.start()
        yield failures
    if failures:
        raise failures[0]


def _steps(
    rig: Rig, path: SlidePath, further: Mapping[str, SlidePath], log: _Log, stack: ExitStack
) -> list[Callable[[], None]]:
    """What each device but the first stage does again and again; they are opened on the stack."""
    steps: list[Callable[[], None]] = []
    if rig.tracker is not None:
        tracker = stack.enter_context(opened_tracker(rig, rig.tracker))
        names = _name_by_identity(tracker.tools, _name_by_handle(tracker.tools, rig.coils))
        steps.append(lambda: _log_tracker(tracker, names, log))
    if rig.mocap is not None:
        mocap = stack.enter_context(ViconStream(rig.mocap, host=rig.mocap_host, timeout=_PATIENCE))
        steps.append(lambda: _log_mocap(mocap, rig, log))
    for one in rig.further:
        driven = _Driven(one, further.get(one.name, path), log)
        stack.callback(driven.close)
        steps.append(driven)
    return steps


def _repeat(step: Callable[[], None], over: threading.Event, failures: list[BaseException]) -> None:
    while not over.is_set() and not failures:
        try:
            step()
        except BaseException as problem:  # raised again by the thread that drives the slide
            failures.append(problem)


def _finish(over: threading.Event, threads: list[threading.Thread]) -> None:
    over.set()
    for thread in threads:
        thread.join()


@dataclass(frozen=True)
class _Log:
    """Passes messages to the session log, the progress and the caller's callback."""

    writer: SessionWriter
    progress: Progress
    on_message: OnMessage | None

    def write(
        self, topic: str, form: dict[str, Any], message: dict[str, Any], at: float, text: str
    ) -> None:
        """Log a message that came `at` a monotonic time, s, and is shown as `text`."""
        if topic not in self.progress.last:
            self.writer.add_topic(topic, form)
        self.writer.write(topic, message, round(1e9 * at))
        self.progress.count[topic] += 1
        self.progress.last[topic] = text
        if self.on_message is not None:
            self.on_message(topic, message)


def _experiment(
    rig: Rig, path: SlidePath, steered: Callable[[float], float] | None, log: _Log
) -> Generator[None, None, None]:
    """Steps of the experiment: wait for clocks, home, follow the path."""
    progress = log.progress
    yield from _wait(_SETTLE)
    progress.began, progress.count = time.monotonic(), Counter()
    if rig.slide is None or rig.stage is None:
        yield from _wait(path.duration)
        return
    with opened_stage(rig.slide, rig.stage) as slide:
        _home(slide, rig.standing)
        for reading in _motion(slide, path, steered):
            _log_slide(reading, log, "")
            yield
        progress.problems.update({f"slide {k}": str(n) for k, n in slide.counts.items() if n})


def _motion(
    slide: LinearStage, path: SlidePath, steered: Callable[[float], float] | None
) -> Iterator[SlideReading]:
    """Readings of a stage on a path, or where it is steered for as long."""
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
    """A further stage on its path: each call logs its next reading; it is opened by the first."""

    def __init__(self, one: FurtherStage, path: SlidePath, log: _Log) -> None:
        self._name, self._log = one.name, log
        self._readings = self._follow(one, path)

    def __call__(self) -> None:
        _log_slide(next(self._readings), self._log, self._name)

    def close(self) -> None:
        """Stand still."""
        self._readings.close()

    @staticmethod
    def _follow(one: FurtherStage, path: SlidePath) -> Generator[SlideReading, None, None]:
        with opened_stage(one.address, one.stage) as slide:
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


def _log_slide(reading: SlideReading, log: _Log, name: str) -> None:
    text = f"{1e3 * reading.travel:.1f} mm, {1e3 * reading.speed:+.1f} mm/s"
    place = {"travel": reading.travel, "speed": reading.speed}
    message = {"time": reading.time, "tick": reading.servo_time, **place}
    log.write(slide_topic(name), _SLIDE, message, reading.time, text)


def _name_by_handle(tools: Sequence[Tool], coils: tuple[Coil, ...]) -> dict[int, str]:
    """Names of the coils by their handles, first of those that state a serial number.

    Raises DeviceError when they do not match.
    """
    handles = {tool.serial: tool.handle for tool in tools}
    free = [tool.handle for tool in tools]
    names = {}
    for coil in sorted(coils, key=lambda coil: not coil.serial):
        if coil.serial and coil.serial not in handles:
            raise DeviceError(
                f"No coil with serial number {coil.serial!r} ({coil.name}) is plugged in, only "
                f"{', '.join(handles)}; plug it in, or correct `serial`."
            )
        handle = handles[coil.serial] if coil.serial else next(iter(free), None)
        if handle not in free:
            raise DeviceError(
                f"{len(tools)} coils are plugged in and the setup names {len(coils)}; plug "
                f"{coil.name} in, or leave it out."
            )
        free.remove(handle)
        names[handle] = coil.name
    return names


def _name_by_identity(tools: Sequence[Tool], names: dict[int, str]) -> dict[str, str]:
    """Names of the coils by serial number, where it is unique, and by place on the plugs.

    A coil that is unplugged and comes back may have another handle, or not report its number.
    """
    named = [tool for tool in tools if tool.handle in names]
    serials = Counter(tool.serial for tool in tools)
    unique = {t.serial: names[t.handle] for t in named if t.serial and serials[t.serial] == 1}
    return {_plug(t): names[t.handle] for t in named} | unique


def _plug(tool: Tool) -> str:
    return f"port {tool.port}, channel {tool.channel}"


def _log_tracker(tracker: Tracker, names: dict[str, str], log: _Log) -> None:
    """Log the next frame, if one comes; a gap in the log shows that none came."""
    frame = tracker.read(_PATIENCE)
    if frame is None:
        return
    coils = {t.handle: names.get(t.serial) or names.get(_plug(t)) for t in tracker.tools}
    for port in frame.ports:
        name = coils.get(port.handle)
        if name is None:
            continue
        stamp = {"time": frame.time, "frame": frame.number}
        quality = {"error": port.quality, "status": port.status or 0}
        pose, text = _shown(port.pose if port.good else None)
        log.write(f"/tracker/{name}", _TRACKER, stamp | quality | pose, frame.arrival, text)
    counts = {f"tracker {k}": str(n) for k, n in tracker.counts.items() if n}
    log.progress.problems.update(counts)


def _log_mocap(mocap: ViconStream, rig: Rig, log: _Log) -> None:
    """Log the next frame; silence is noted but not fatal, for the robot needs no motion capture."""
    try:
        frame = mocap.read()
    except DeviceError as silence:
        log.progress.problems["mocap"] = str(silence)
        return
    for body in rig.bodies:
        pose, text = _shown(frame.poses.get(body.name))
        message = {"time": frame.received, "frame": frame.number, **pose}
        log.write(f"/mocap/{body.name}", _MOCAP, message, frame.received, text)


def _shown(pose: Array | None) -> tuple[dict[str, Any], str]:
    """A pose's entries of a message, and its position as text."""
    if pose is None:
        return {"position": None, "quaternion": None}, "not seen"
    return pose_entries(pose), ", ".join(f"{1e3 * x:.1f}" for x in pose[:3, 3]) + " mm"
