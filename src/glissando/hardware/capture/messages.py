"""Messages of a session log: one for each reading or frame of a device."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.hardware.capture.coil_names import plug
from glissando.hardware.capture.online import OnMessage
from glissando.hardware.capture.setup import Rig, slide_topic
from glissando.hardware.drivers import SlideReading, Tracker, ViconStream
from glissando.io.session_log import INTEGER, NUMBER, SessionWriter, numbers, schema
from glissando.model.table import pose_table

_OFF = 1.0  # s by which the stamp of a coil's first frame may differ from its arrival
_POSE = {"position": numbers(3), "quaternion": numbers(4)}
_TRACKER = schema(
    "glissando.Coil", time=NUMBER, frame=INTEGER, **_POSE, error=NUMBER, status=INTEGER
)
_SLIDE = schema("glissando.Slide", time=NUMBER, tick=NUMBER, travel=NUMBER, speed=NUMBER)
_MOCAP = schema("glissando.Body", time=NUMBER, frame=INTEGER, **_POSE)


@dataclass
class Progress:
    """State of a running experiment.

    Attributes:
        began: Time from which messages are counted, monotonic s.
        count: Messages so far, by topic.
        last: The last message of each topic, as text.
        problems: Description of each device's present problem or error counts.
        total: Duration of the slide's path, s.
    """

    began: float = field(default_factory=time.monotonic)
    count: Counter[str] = field(default_factory=Counter)
    last: dict[str, str] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    total: float = 0.0

    def rate(self, topic: str) -> float:
        """Mean number of messages a second since `began`."""
        return self.count[topic] / max(time.monotonic() - self.began, 1e-9)


@dataclass(frozen=True)
class MessageLog:
    """Passes messages to the session log, the progress and the caller's callback."""

    writer: SessionWriter
    progress: Progress
    on_message: OnMessage | None

    def write(
        self, topic: str, form: dict[str, Any], message: dict[str, Any], at: float, text: str
    ) -> None:
        """Log a message that arrived at monotonic time `at`, s; `text` is its form for display."""
        if topic not in self.progress.last:
            self.writer.add_topic(topic, form)
        self.writer.write(topic, message, round(1e9 * at))
        self.progress.count[topic] += 1
        self.progress.last[topic] = text
        if self.on_message is not None:
            self.on_message(topic, message)


def log_slide(reading: SlideReading, log: MessageLog, name: str) -> None:
    """Log the travel and speed of a stage.

    Args:
        reading: The stage's reading, m and m/s.
        log: Receives the message.
        name: Name of the stage, empty for the rig's first.
    """
    text = f"{1e3 * reading.travel:.1f} mm, {1e3 * reading.speed:+.1f} mm/s"
    place = {"travel": reading.travel, "speed": reading.speed}
    message = {"time": reading.time, "tick": reading.servo_time, **place}
    log.write(slide_topic(name), _SLIDE, message, reading.time, text)


def log_tracker_frame(
    tracker: Tracker, names: dict[str, str], log: MessageLog, patience: float
) -> None:
    """Log the next frame if one arrives in time; otherwise the log has a gap.

    Args:
        tracker: The tracker.
        names: Names of the coils by serial number or plug, see `name_by_identity`.
        log: Receives the messages.
        patience: Seconds to wait for a frame.

    Raises:
        DeviceError: The tracker failed, or a coil's first frame is stamped far from its arrival.
    """
    frame = tracker.read(patience)
    if frame is None:
        log.progress.problems["tracker"] = f"sent nothing for {patience:g} s"
        return
    log.progress.problems.pop("tracker", None)
    coils = {t.handle: names.get(t.serial) or names.get(plug(t)) for t in tracker.tools}
    for port in frame.ports:
        name = coils.get(port.handle)
        if name is None:
            continue
        off = frame.time - frame.arrival
        if abs(off) > _OFF and f"/tracker/{name}" not in log.progress.last:
            raise DeviceError(
                f"Coil {name} is stamped {abs(off):.3g} s {'after' if off > 0.0 else 'before'} its "
                f"arrival; set both clocks by NTP, or take frames by their arrival (clock=arrival)."
            )
        stamp = {"time": frame.time, "frame": frame.number}
        quality = {"error": port.quality, "status": port.status or 0}
        pose, text = _pose_entries(port.pose if port.good else None)
        log.write(f"/tracker/{name}", _TRACKER, stamp | quality | pose, frame.arrival, text)
    counts = {f"tracker {k}": str(n) for k, n in tracker.counts.items() if n}
    log.progress.problems.update(counts)


def log_mocap_frame(mocap: ViconStream, rig: Rig, log: MessageLog) -> None:
    """Log the next frame; a timeout is not fatal, as the estimate does not need motion capture.

    Args:
        mocap: The motion capture.
        rig: The rig, which names the bodies to log.
        log: Receives the messages.
    """
    try:
        frame = mocap.read()
    except DeviceError as silence:
        log.progress.problems["mocap"] = str(silence)
        return
    log.progress.problems.pop("mocap", None)
    log.progress.problems.update({f"mocap {k}": str(n) for k, n in mocap.counts.items() if n})
    for body in rig.bodies:
        pose, text = _pose_entries(frame.poses.get(body.name))
        message = {"time": frame.received, "frame": frame.number, **pose}
        log.write(f"/mocap/{body.name}", _MOCAP, message, frame.received, text)


def _pose_entries(pose: Array | None) -> tuple[dict[str, Any], str]:
    """A pose as the entries of a message, and its position as text."""
    if pose is None:
        return {"position": None, "quaternion": None}, "not seen"
    return pose_table(pose), ", ".join(f"{1e3 * x:.1f}" for x in pose[:3, 3]) + " mm"
