"""Recordings: streams of rows, their robot, and the choice of streams to use and to judge by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows, Stream, clean, steady
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_track import slide_motion
from glissando.model.tendons.channel import Channel, ends_of

_TRUTH_STD = 1e-6  # noise of a truth stream that states none: negligible against any posterior


@dataclass(frozen=True)
class Recording(ShortRepr):
    """A recorded session.

    Attributes:
        name: Name of the recording.
        folder: Folder from which it was read.
        streams: Streams by name, in SI units and, unless their frame is unknown, the world frame.
        robot: Robot that the recording names; None if it names none.
        window: First and last time, s, to estimate; None for the whole recording.
        frames: Poses T_wf (4, 4) of the frames in which streams were recorded, by stream; absent
            for streams recorded in the world frame.
        allow: Names of plausibility checks that are switched off.
        unknown_frames: Frames whose pose in the world is unknown; their streams stay in them.
    """

    name: str
    folder: Path
    streams: dict[str, Stream]
    robot: Robot | None
    window: tuple[float, float] | None
    frames: dict[str, Array] = field(default_factory=dict)
    allow: tuple[str, ...] = ()
    unknown_frames: frozenset[str] = frozenset()

    @staticmethod
    def of(streams: Sequence[Stream], name: str, robot: Robot | None = None) -> Recording:
        """A recording of streams in the world frame, such as those of a simulated session.

        Args:
            streams: Streams in the world frame.
            name: Name of the recording, in messages.
            robot: Robot to which the sensors are attached.
        """
        return Recording(name, Path(name), {stream.name: stream for stream in streams}, robot, None)

    def readings(
        self,
        names: Sequence[str],
        robot: Robot,
        window: tuple[float, float],
        *,
        as_truth: bool = False,
    ) -> tuple[list[Readings], dict[str, dict[str, int]]]:
        """Readings of the named streams inside a window, and the rows dropped from each.

        Args:
            names: Names of streams.
            robot: Robot whose file gives the noise of streams that state none.
            window: First and last time, s; both the stamp and the time corrected by known delays
                of `robot` must lie inside.
            as_truth: Whether the streams are ground truth; a truth stream without noise then counts
                as exact, while as a sensor it needs noise like any other.

        Returns:
            Readings of each stream, and the counts of dropped rows by stream and reason.

        Raises:
            RecordingError: A name is unknown, the window is invalid, a stream has no noise, an
                arclength is off the robot, or the pose of a stream's frame is unknown and not
                among the robot's sensor parameters.
        """
        _require_choice(names, robot, window)
        out, dropped = [], {}
        moving = [p for p in robot.sensor_parameters if p.known and p.moves]
        for name in names:
            stream = self.stream(name)
            kind = stream.rows.kind
            self._require_frame(stream, robot)
            rows = clean(stream.rows, robot.sensor_range.get(kind), stream.keep_repeats)
            if not as_truth and kind in robot.sensor_rate:
                rows = steady(rows, robot.sensor_rate[kind])
            _require_on_robot(name, rows, robot, stream.channel)
            if rows.dropped:
                dropped[name] = rows.dropped
            readings = _as_readings(replace(stream, rows=rows), robot, as_truth)
            stamp, measured = rows.time, corrected(readings, moving).time
            inside = np.minimum(stamp, measured) >= window[0]
            out.append(readings.select(inside & (np.maximum(stamp, measured) <= window[1])))
        return out, dropped

    def stream(self, name: str) -> Stream:
        """The stream of a name.

        Raises:
            RecordingError: The recording has no such stream.
        """
        if name not in self.streams:
            raise RecordingError(
                f"{self.name} has no stream {name!r}; it has {', '.join(self.streams)}."
            )
        return self.streams[name]

    def _require_frame(self, stream: Stream, robot: Robot) -> None:
        """Raise RecordingError unless the frame of a stream is known or will be estimated."""
        estimated = [p.streams for p in robot.sensor_parameters if p.kind == "frame"]
        if stream.frame in self.unknown_frames and not any(stream.name in s for s in estimated):
            raise RecordingError(
                f"Stream {stream.name!r} is in the frame {stream.frame!r}, whose place in the "
                f"world is not known: run glissando calibrate {quote(str(self.folder))}, which "
                f"finds it from motion capture, with mount, delay and arclength, or state it in "
                f"[frames.{stream.frame}] of recording.toml."
            )

    def choose(
        self, use: Sequence[str] | None, truth: Sequence[str] | None
    ) -> tuple[list[str], list[str]]:
        """Choose the streams to use and the truth streams; by default as the recording marks them.

        Args:
            use: Names of streams to use; None for all that are not truth.
            truth: Names of truth streams; None for those that the recording marks.

        Returns:
            Names of the streams to use, and of the truth streams.

        Raises:
            RecordingError: A stream is in both, or its kind cannot be truth.
        """
        marked = [s.name for s in self.streams.values() if s.truth]
        chosen_truth = marked if truth is None else list(dict.fromkeys(truth))
        for name in chosen_truth:
            if name in self.streams and not self.streams[name].rows.sensor.tracker:
                trackers = ", ".join(kind for kind, sensor in SENSORS.items() if sensor.tracker)
                raise RecordingError(
                    f"Stream {name!r} is a {self.streams[name].rows.kind}; truth must be one of "
                    f"{trackers}."
                )
        if use is None:
            use = [n for n in self.streams if n not in marked and n not in chosen_truth]
        both = set(use) & set(chosen_truth)
        if both:
            raise RecordingError(
                f"{', '.join(sorted(both))} cannot be used and be truth at once; name each stream "
                f"in --use or in --truth."
            )
        return list(dict.fromkeys(use)), chosen_truth

    def span(self, names: Sequence[str] = ()) -> tuple[float, float]:
        """First and last time, s, of the named streams together, by default of all.

        Raises:
            RecordingError: The streams have no rows, as in a journal without any readings.
        """
        times = [self.streams[name].rows.time for name in names or self.streams]
        times = [time for time in times if time.size]
        if not times:
            of = f" of {', '.join(names)}" if names else ""
            raise RecordingError(
                f"{self.folder} holds no readings{of}; see that its sensors send, and record again."
            )
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def _require_choice(names: Sequence[str], robot: Robot, window: tuple[float, float]) -> None:
    """Raise RecordingError for a text as `names`, a `robot` not loaded, or an invalid window."""
    if isinstance(names, str):
        raise RecordingError(f"The streams are {names!r}; give a list of names, [{names!r}].")
    if not isinstance(robot, Robot):
        raise RecordingError(f"The robot is {robot!r}; give load_robot(…).")
    try:
        first, last = (float(time) for time in window)
    except (TypeError, ValueError):
        raise RecordingError(f"The window is {window!r}; give first and last time, s.") from None
    if not first <= last:
        raise RecordingError(f"The window {first:g} to {last:g} s is empty; give T0 < T1.")


def _require_on_robot(name: str, rows: Rows, robot: Robot, channel: Channel | None) -> None:
    low, high = ends_of(channel, robot.length)
    excess = np.maximum(rows.arclength - high, low - rows.arclength)
    bad = np.flatnonzero(excess > 1e-9)
    if bad.size:
        places = ", ".join(f"{rows.arclength[i]:.4g}" for i in bad[:3])
        raise RecordingError(
            f"Stream {name!r}: {bad.size} rows lie outside robot {robot.name!r} of length "
            f"{robot.length:g} m: rows {', '.join(map(str, bad[:3]))} at {places} m, up to "
            f"{excess.max():.3g} m beyond. Choose another robot with --robot, or correct them."
        )


def _as_readings(stream: Stream, robot: Robot, as_truth: bool) -> Readings:
    rows = stream.rows
    std = stream.std if stream.std is not None else robot.sensor_std.get(rows.kind)
    if as_truth and stream.truth and stream.std is None:
        std = np.full(rows.sensor.rows, _TRUTH_STD)
    if std is None:
        raise RecordingError(
            f"Stream {stream.name!r}: neither the recording nor robot {robot.name!r} states the "
            f"noise of a {rows.kind} sensor; add [sensors.{rows.kind}] std to the robot file."
        )
    return rows.sensor(
        time=rows.time,
        arclength=rows.arclength,
        values=rows.values,
        cov=std**2 if std.size > 1 else std[0] ** 2,
        mount=stream.mount,
        channel=stream.channel,
        loss=None if as_truth else robot.sensor_loss.get(rows.kind),
        name=stream.name,
        **slide_motion(rows.time, rows.arclength),
        **rows.settings,
    )
