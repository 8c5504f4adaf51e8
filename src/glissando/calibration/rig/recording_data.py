"""Conversion of a recording into rig data, and application of the calibration to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.result import Calibration, apply
from glissando.calibration.rig.rig import Body, Noise, RigData
from glissando.errors import RecordingError
from glissando.io.csv_stream import Stream
from glissando.io.recording import Recording
from glissando.model.robot import Robot

_SLIDES = 1e-3  # m: a sensor whose arclength varies by less is fixed
_ARCLENGTH_STD = 5e-3  # m: prior standard deviation of its arclength


def recording_data(recording: Recording, coil: str | None = None) -> RigData:
    """Rig data of a recording with a tracker and motion capture, each with its own clock.

    The arclengths of the coil's rows are the slide's travel; truth streams are motion capture.

    Args:
        recording: The recording.
        coil: Name of the coil or pose stream to calibrate; by default the only one, else the only
            one in an unknown frame, else the only one of these that slides.

    Raises:
        RecordingError: There is no such stream, there are several, or truth has no poses.
    """
    stream = _coil(recording, coil)
    rows = stream.rows
    bodies = {s.name: _body(s) for s in recording.streams.values() if s.truth and _fixed_pose(s)}
    if not bodies:
        raise RecordingError(
            f"{recording.name} has no motion capture to calibrate against: mark streams of poses "
            f"as truth, with import --truth or truth = true in recording.toml."
        )
    farthest, slides = float(rows.arclength.max()), float(np.ptp(rows.arclength)) > _SLIDES
    order = np.argsort(rows.time, kind="stable")
    return RigData(
        coil_name=stream.name,
        coil_time=rows.time[order],
        coil=rows.values[order],
        slide_time=rows.time[order] if slides else np.zeros(0),
        travel=farthest - rows.arclength[order] if slides else np.zeros(0),
        bodies=bodies,
        coil_arclength=farthest,
        coil_arclength_std=_ARCLENGTH_STD,
        direction=-1 if slides else 0,
        noise=_noise(recording, list(bodies)),
        channel=stream.channel,
        mount=stream.mount,
    )


def calibrated(
    recording: Recording, calibration: Calibration, data: RigData, robot: Robot
) -> Recording:
    """Apply a calibration to a recording: coil in the world, calibrated times, arclengths, mount.

    A pose stream becomes a coil stream with the same noise and without roll. Other streams in the
    coil's frame share its clock and are transformed into the world with it. Repeated poses of a
    frozen tracker are removed when the recording is read.

    Args:
        recording: The recording.
        calibration: Calibration from this recording.
        data: Rig data from `recording_data`.
        robot: The robot, whose ends bound the coil's arclength.
    """
    rig, own = calibration.rig, recording.streams[data.coil_name]
    coil = apply(calibration, data, robot).streams[own.name]
    std = robot.sensor_std.get(own.rows.kind) if own.std is None else own.std
    std = None if std is None else std[: coil.rows.sensor.rows]
    streams = dict(recording.streams)
    streams[own.name] = replace(coil, std=std)
    for name, stream in recording.streams.items():
        if stream.frame == own.frame != "world" and stream is not own:
            values = stream.rows.sensor.in_frame(stream.rows.values, rig.T_wt)
            rows = replace(stream.rows, time=rig.true_time(stream.rows.time), values=values)
            streams[name] = replace(stream, rows=rows, frame="world", keep_repeats=False)
    left = recording.unknown_frames - {own.frame}
    return replace(recording, streams=streams, robot=robot, unknown_frames=left)


def _coil(recording: Recording, name: str | None) -> Stream:
    """Stream to calibrate."""
    coils = [s for s in recording.streams.values() if s.rows.kind in ("coil", "pose")]
    coils = [s for s in coils if not s.truth]
    known = ", ".join(s.name for s in coils)
    if name is not None:
        coils = [s for s in coils if s.name == name]
    for better in (
        [s for s in coils if s.frame in recording.unknown_frames],
        [s for s in coils if np.ptp(s.rows.arclength) > _SLIDES],
    ):
        coils = [s for s in coils if s in better] if len(coils) > 1 and better else coils
    if len(coils) != 1:
        raise RecordingError(
            f"{recording.name}: say with --coil which stream of a tracker, of coils or poses, is "
            f"to be calibrated; besides truth it has {known or 'none'}."
        )
    return coils[0]


def _fixed_pose(stream: Stream) -> bool:
    """Whether a stream holds poses at one fixed arclength."""
    rows = stream.rows
    return rows.kind == "pose" and rows.time.size > 0 and float(np.ptp(rows.arclength)) < 1e-6


def _body(stream: Stream) -> Body:
    rows = stream.rows
    order = np.argsort(rows.time, kind="stable")
    place = float(rows.arclength[0])
    return Body(place, stream.mount, rows.time[order], rows.values[order])


def _noise(recording: Recording, bodies: list[str]) -> Noise:
    """Preset noise, with motion capture's as stated by the truth streams, if any."""
    stated = [s for b in bodies if (s := recording.streams[b].std) is not None and s.size == 6]
    if not stated:
        return Noise()
    std = np.mean(stated, axis=0)
    return replace(Noise(), mocap=np.array([std[:3].mean(), std[3:].mean()]))
