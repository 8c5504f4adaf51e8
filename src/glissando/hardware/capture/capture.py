"""One experiment: the slide follows its path while every device is listened to.

Each device has a thread that writes what it says to the session log, the tracker a process too that
asks it; the slide is driven from the caller's thread. Whatever ends the experiment – its end, an
exception, Ctrl-C – stops the slide first.
"""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.capture.listening import Listening, listening
from glissando.hardware.capture.online import Hear
from glissando.hardware.capture.setup import Coil, Rig
from glissando.hardware.drivers import Slide, SlideReading, ViconStream
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.io.session_log import INTEGER, NUMBER, SessionWriter, numbers, schema
from glissando.model.slide_path import SlidePath

LOG = "session.mcap"
_POSE = {"position": numbers(3), "quaternion": numbers(4)}
_TRACKER = schema(
    "glissando.Coil", time=NUMBER, frame=INTEGER, **_POSE, error=NUMBER, status=INTEGER
)
_SLIDE = schema("glissando.Slide", time=NUMBER, tick=NUMBER, travel=NUMBER, speed=NUMBER)
_MOCAP = schema("glissando.Body", time=NUMBER, frame=INTEGER, **_POSE)
_PATIENCE = 0.5  # s to wait for a device before looking whether the experiment is over
_SETTLE = 0.5  # s before the slide moves, so that the tracker's clock is known
_SAMPLES = 0.01  # s between the points of a path given to the stage


@dataclass
class Progress:
    """What came so far: messages by topic, when they began, the last of each, what went wrong."""

    began: float = field(default_factory=time.monotonic)
    count: Counter[str] = field(default_factory=Counter)
    last: dict[str, str] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    total: float = 0.0  # s that the slide's path lasts

    def rate(self, topic: str) -> float:
        """Messages a second since the beginning."""
        return self.count[topic] / max(time.monotonic() - self.began, 1e-9)

    def note(self, topic: str, said: str) -> None:
        """One more message."""
        self.count[topic] += 1
        self.last[topic] = said


Watch = Callable[[Progress], None]
"""Called a few times a second while the experiment runs."""


def capture(
    rig: Rig,
    path: SlidePath,
    folder: Path,
    *,
    watch: Watch | None = None,
    hear: Hear | None = None,
) -> Progress:
    """Run an experiment and log it in a new `folder`; the log is whole up to the last second.

    Raises DeviceError when a device fails; what came before is in the log, and the slide stands.
    """
    folder.mkdir(parents=True, exist_ok=False)
    progress = Progress(total=path.duration)
    over = threading.Event()
    failure: list[BaseException] = []
    metadata = {"setup": json.dumps(rig.described())}
    with SessionWriter(folder / LOG, metadata) as writer, ExitStack() as stack:
        log = _Log(writer, progress, hear)
        listeners = []
        if rig.tracker is not None:
            tracker = stack.enter_context(listening(rig.tracker, rig.baud))
            names = _known_by(tracker.tools, _plugged(tracker.tools, rig.coils))
            listeners.append(lambda: _hear_tracker(tracker, names, log))
        if rig.mocap is not None:
            mocap = stack.enter_context(ViconStream(rig.mocap, timeout=_PATIENCE))
            listeners.append(lambda: _hear_mocap(mocap, rig, log))
        threads = [threading.Thread(target=_listen, args=(h, over, failure)) for h in listeners]
        stack.callback(_finish, over, threads)
        for thread in threads:
            thread.start()
        for _ in _experiment(rig, path, log):
            if failure:
                raise failure[0]
            if watch is not None:
                watch(progress)
    if failure:
        raise failure[0]
    return progress


def _listen(hear: Callable[[], None], over: threading.Event, failure: list[BaseException]) -> None:
    while not over.is_set() and not failure:
        try:
            hear()
        except BaseException as problem:  # told by whoever drives the experiment
            failure.append(problem)


def _finish(over: threading.Event, threads: list[threading.Thread]) -> None:
    over.set()
    for thread in threads:
        thread.join()


@dataclass(frozen=True)
class _Log:
    """Where messages go: to the session's log, then to who counts and who listens."""

    writer: SessionWriter
    progress: Progress
    hear: Hear | None

    def write(
        self, topic: str, form: dict[str, Any], message: dict[str, Any], at: float, said: str
    ) -> None:
        """A message that came `at` a monotonic time, s, and what to show of it."""
        if topic not in self.progress.last:
            self.writer.add_topic(topic, form)
        self.writer.write(topic, message, round(1e9 * at))
        self.progress.note(topic, said)
        if self.hear is not None:
            self.hear(topic, message)


def _experiment(rig: Rig, path: SlidePath, log: _Log) -> Iterator[None]:
    """Steps of the experiment: wait for clocks, home, follow the path."""
    progress = log.progress
    yield from _wait(_SETTLE)
    progress.began, progress.count = time.monotonic(), Counter()
    if rig.slide is None or rig.stage is None:
        yield from _wait(path.duration)
        return
    with Slide(rig.slide, rig.stage) as slide:
        if rig.standing is None:
            slide.home_at_stop()
        else:
            slide.home_here(rig.standing)
        times = np.append(np.arange(0.0, path.duration, _SAMPLES), path.duration)
        for reading in slide.follow(times, path.at(times)):
            _log_slide(reading, log)
            yield
        progress.problems.update({f"slide {k}": str(n) for k, n in slide.counts.items() if n})


def _wait(seconds: float) -> Iterator[None]:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.02)
        yield


def _log_slide(reading: SlideReading, log: _Log) -> None:
    message = {
        "time": reading.time,
        "tick": reading.servo_time,
        "travel": reading.travel,
        "speed": reading.speed,
    }
    said = f"{1e3 * reading.travel:.1f} mm, {1e3 * reading.speed:+.1f} mm/s"
    log.write("/slide", _SLIDE, message, reading.time, said)


def _plugged(tools: list[Tool], coils: tuple[Coil, ...]) -> dict[int, str]:
    """Names of the coils by their handles. Raises DeviceError when they do not match."""
    serials = {tool.serial: tool.handle for tool in tools}
    free = [tool.handle for tool in tools]
    found = {}
    for coil in coils:
        if coil.serial and coil.serial not in serials:
            raise DeviceError(
                f"No coil with serial number {coil.serial!r} ({coil.name}) is plugged in; there "
                f"are {', '.join(serials)}."
            )
        handle = serials[coil.serial] if coil.serial else next(iter(free), None)
        if handle not in free:
            raise DeviceError(
                f"{len(tools)} coils are plugged in and the setup names {len(coils)}; plug "
                f"{coil.name} in, or leave it out."
            )
        free.remove(handle)
        found[handle] = coil.name
    return found


def _known_by(tools: list[Tool], names: dict[int, str]) -> dict[str, str]:
    """Names of the coils by serial number, if no other has it, and by place on the plugs.

    A coil that is unplugged and comes back may have another handle, or not tell its number.
    """
    serials = Counter(tool.serial for tool in tools)
    known = {}
    for tool in tools:
        if tool.handle in names:
            known[_place(tool)] = names[tool.handle]
            if tool.serial and serials[tool.serial] == 1:
                known[tool.serial] = names[tool.handle]
    return known


def _place(tool: Tool) -> str:
    return f"port {tool.port}, channel {tool.channel}"


def _hear_tracker(tracker: Listening, names: dict[str, str], log: _Log) -> None:
    """Log the next frame; that none comes is told by what is not in the log."""
    frame = tracker.read(_PATIENCE)
    if frame is None:
        return
    coils = {t.handle: names.get(t.serial) or names.get(_place(t)) for t in tracker.tools}
    for port in frame.ports:
        name = coils.get(port.handle)
        if name is None:
            continue
        pose = _pose(port.pose if port.good else None)
        said = {"time": frame.time, "frame": frame.number, "error": port.quality}
        message = {**said, "status": port.status or 0, **pose}
        log.write(f"/tracker/{name}", _TRACKER, message, frame.arrival, _told(pose["position"]))
    counts = {f"tracker {k}": str(n) for k, n in tracker.counts.items() if n}
    log.progress.problems.update(counts)


def _hear_mocap(mocap: ViconStream, rig: Rig, log: _Log) -> None:
    """Log the next frame; silence is noted, not fatal: the experiment is the robot's."""
    try:
        frame = mocap.read()
    except DeviceError as silence:
        log.progress.problems["mocap"] = str(silence)
        return
    for body in rig.bodies:
        pose = _pose(frame.poses.get(body.name))
        message = {"time": frame.received, "frame": frame.number, **pose}
        said = _told(pose["position"])
        log.write(f"/mocap/{body.name}", _MOCAP, message, frame.received, said)


def _pose(pose: Array | None) -> dict[str, list[float] | None]:
    if pose is None:
        return {"position": None, "quaternion": None}
    quaternion = se3.quaternion(pose[:3, :3])
    return {"position": pose[:3, 3].tolist(), "quaternion": quaternion.tolist()}


def _told(position: list[float] | None) -> str:
    return "not seen" if position is None else ", ".join(f"{1e3 * x:.1f}" for x in position) + " mm"
