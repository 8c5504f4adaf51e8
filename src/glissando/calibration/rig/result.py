"""Result of a calibration, its TOML file, and its application to a session."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from glissando.calibration.rig.advice import StreamFit
from glissando.calibration.rig.carriage import SlideFit
from glissando.calibration.rig.other_coil import OtherCoil
from glissando.calibration.rig.rig import ANYWHERE, MOUNT, PARAMETERS, Rig, RigData
from glissando.errors import GlissandoError, RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.io.csv_stream import Rows, Stream
from glissando.io.provenance import require_readable, stated_format, versions
from glissando.io.recording import Recording
from glissando.io.toml_table import read_toml
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.short_repr import ShortRepr
from glissando.model.table import Table, pose_table
from glissando.model.tendons.channel import Channel, ends_of

_OF_PLACE = "frame", "mount", "tracker"  # constants that are observable with motion capture only
_OFF = 1e-3  # m beyond the robot's ends at which a sliding coil is off the robot
_UNITS = {"delay": ("ms", 1e3), "rate": ("ppm", 1e6), "lead": ("1", 1.0)}


@dataclass(frozen=True)
class Calibration(ShortRepr):
    """Constants of a rig with their joint covariance.

    Attributes:
        rig: The constants.
        cov: Covariance (17, 17) in the order of PARAMETERS: right twist of the tracker's frame
            [m, rad], mount x, y [m] and tilts [rad], zero [m], lead, backlash [m], and delay [s]
            and rate of both clocks.
        coil_name: Name of the coil.
        log_odds: Log odds of the direction; infinite if only one is possible.
        fits: Residuals of each stream.
        warnings: Sentences on constants that the session leaves uncertain, and on misfits.
        tube: Slide constants estimated from the body on the sliding tube, or None without one.
        channel: Estimated channel beside the backbone, or None if the coil slides in none; the
            mount's x and y are then the channel's offset from the stated one.
    """

    rig: Rig
    cov: Array
    coil_name: str
    log_odds: float
    fits: tuple[StreamFit, ...] = ()
    warnings: tuple[str, ...] = ()
    tube: SlideFit | None = None
    channel: Channel | None = None

    @property
    def std(self) -> Array:
        """Standard deviations (17,) in the order of PARAMETERS."""
        return np.sqrt(self.cov.diagonal())

    @property
    def placed(self) -> bool:
        """Whether the tracker's frame was estimated, which requires motion capture."""
        return bool(np.any(self.std[:6] < ANYWHERE))

    def values(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation by parameter; the frame as position and rotation vector.

        Standard deviations of the frame are of these world coordinates here; those in `std` are of
        a right twist, in the tracker's axes.
        """
        rig, std = self.rig, self.std
        turn = rig.T_wt[:3, :3]
        slope = se3.right_jacobian_inverse(np.append(np.zeros(3), se3.so3_log(turn)))[3:, 3:]
        for at, by in ((slice(0, 3), turn), (slice(3, 6), slope)):
            std[at] = np.sqrt(np.diagonal(by @ self.cov[at, at] @ by.T))
        frame = [*rig.T_wt[:3, 3], *se3.so3_log(rig.T_wt[:3, :3])]
        rest = [rig.zero, rig.lead, rig.backlash, *rig.tracker_clock, *rig.slide_clock]
        numbers = [*frame, *rig.mount, *rest]
        return {
            name: (float(value), float(std))
            for name, value, std in zip(PARAMETERS, numbers, std, strict=True)
        }

    def displayed(self) -> list[tuple[str, float, float, str]]:
        """Name, value, standard deviation and unit (mm, mrad, ms, ppm) of estimated constants."""
        out = []
        for name, (value, std) in self.values().items():
            if std > 0.0 and (self.placed or not name.startswith(_OF_PLACE)):
                angle = "rotation" in name or "tilt" in name
                unit, size = ("mrad", 1e3) if angle else _UNITS.get(name.split()[-1], ("mm", 1e3))
                out.append((name, size * value, size * std, unit))
        if self.channel is not None:
            (radius, turned), sigma = self._polar()
            out.append(("channel radius", 1e3 * radius, 1e3 * float(sigma[0]), "mm"))
            out.append(("channel angle", 1e3 * turned, 1e3 * float(sigma[1]), "mrad"))
        return out

    def _channel_tables(self) -> dict[str, Any]:
        """TOML tables of the estimated channel and its offset (x, y) from the stated one, m."""
        if self.channel is None:
            return {}
        moved = self.rig.mount[:2].tolist()
        return {"channel": self.channel.to_table(), "channel_offset": moved}

    def _polar(self) -> tuple[tuple[float, float], Array]:
        """Radius and angle of the channel, with their standard deviations (2,)."""
        assert self.channel is not None
        radius, angle = self.channel.radius, self.channel.angle
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        std = np.sqrt(np.diagonal(turn @ self.cov[6:8, 6:8] @ turn.T))
        return (radius, angle), std / [1.0, max(radius, 1e-9)]

    @property
    def _mount(self) -> Array:
        """Estimated mount (4, 4) of the coil in the cross-section, or in the estimated channel."""
        return self.rig.coil_mount if self.channel is None else self.rig.tilt

    def sensor_parameters(self) -> tuple[SensorParameter, ...]:
        """Frame, mount and delay of the coil as known sensor parameters for a robot file.

        For recordings that have the coil's poses in the tracker's frame and time, with arclengths.
        Empty if the tracker's frame was not estimated.
        """
        if not self.placed:
            return ()
        parts = {
            "frame": se3.log(self.rig.T_wt),
            "mount": se3.log(self._mount),
            "time_offset": self.rig.tracker_clock[:1],
        }
        streams = (self.coil_name,)
        return tuple(
            SensorParameter(f"{self.coil_name} {kind}", kind, streams, value, np.zeros(value.size))
            for kind, value in parts.items()
        )

    def save(self, path: Path) -> None:
        """Write a TOML file for `load_calibration`; docs/calibration.md describes its keys."""
        rig, std = self.rig, self.std
        document: dict[str, Any] = {
            "format": stated_format("calibration"),
            "versions": versions(),
            "epoch": rig.epoch,
            "log_odds": float(self.log_odds),
            "frames": {"tracker": {**pose_table(rig.T_wt), "std": std[:6].tolist()}},
            "coil": {
                "name": self.coil_name,
                "mount": {**pose_table(self._mount), "std": std[6:10].tolist()},
                "clock": _clock(rig.tracker_clock, std[13:15]),
                **self._channel_tables(),
            },
            "slide": {
                "zero": rig.zero,
                "direction": rig.direction,
                "lead": rig.lead,
                "backlash": rig.backlash,
                "std": std[10:13].tolist(),
                "clock": _clock(rig.slide_clock, std[15:17]),
            },
            "warnings": list(self.warnings),
            "covariance": {"order": list(PARAMETERS), "rows": self.cov.tolist()},
            "sensor_parameters": [
                {
                    "name": u.name,
                    "kind": u.kind,
                    "streams": list(u.streams),
                    "value": u.value.tolist(),
                }
                for u in self.sensor_parameters()
            ],
        }
        write_text(path, tomli_w.dumps(document))


def _clock(clock: Array, std: Array) -> dict[str, Any]:
    return {"delay": float(clock[0]), "rate": float(clock[1]), "std": std.tolist()}


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Args:
        path: File that `Calibration.save` wrote.

    Raises:
        GlissandoError: If the file cannot be read; the message names the key that is wrong.
    """
    table = read_toml(Path(path), GlissandoError)
    require_readable(table.text("format"), "calibration", path)
    frames, coil, slide, covariance = (
        table.subtable(key) for key in ("frames", "coil", "slide", "covariance")
    )
    epoch = table.number("epoch", positive=False)
    odds = table.peek("log_odds")
    odds = 0.0 if odds is None else odds
    if isinstance(odds, bool) or not isinstance(odds, int | float):  # infinite if sure
        raise table.fail("log_odds", f"is {str(odds)[:60]}; give a number.")
    direction = slide.number("direction", positive=False)
    if direction not in (1.0, -1.0):
        raise slide.fail("direction", f"is {direction:g}; give 1 or -1.")
    mount = se3.log(coil.subtable("mount").pose())[MOUNT]
    mount[:2] += coil.vector("channel_offset", 2, np.zeros(2))
    rig = Rig(
        frames.subtable("tracker").pose(),
        int(direction),
        slide.number("zero", positive=False),
        epoch,
        mount,
        slide.number("lead"),
        slide.number("backlash", positive=False),
        _read_clock(coil),
        _read_clock(slide),
    )
    cov = covariance.matrix("rows", len(PARAMETERS))
    warnings = table.peek("warnings") or []
    if not (isinstance(warnings, list) and all(isinstance(text, str) for text in warnings)):
        raise table.fail("warnings", f"is {str(warnings)[:60]}; give a list of sentences.")
    constants = rig, cov, coil.text("name"), float(odds)
    return Calibration(*constants, warnings=tuple(warnings), channel=coil.channel())


def _read_clock(device: Table) -> Array:
    clock = device.subtable("clock")
    return np.array([clock.number(key, positive=False) for key in ("delay", "rate")])


def apply(calibration: Calibration, data: RigData, robot: Robot | None = None) -> Recording:
    """Turn a session into a recording: the coil in the world, motion capture as truth.

    Args:
        calibration: Calibration of this rig.
        data: The session.
        robot: The robot, whose ends bound the coil's arclength.

    Returns:
        A recording of the coil at true times and arclengths, with its mount. Repeated poses of a
        frozen tracker are kept here and removed when the recording is read. Readings at which the
        slide was not recorded, or a sliding coil is a millimetre or more off the robot, are
        removed. A fixed coil beyond the robot's end is placed at the end, and its mount extended by
        the distance. The tracker's other coils are included at true times and their stated
        arclengths. If the calibration did not estimate the tracker's frame, the stated frame is
        used; without one, the frame is unknown.

    Raises:
        RecordingError: If no coil reading remains.
    """
    rig, length = _with_stated_frame(calibration, data), None if robot is None else robot.length
    name, channel = data.coil_name, rig.channel(data)
    rows, mount = _rows_of_coil(rig, data, length)
    streams = {name: Stream(name, rows, mount=mount, channel=channel)}
    for other in data.others:
        rows = _rows_of(other, rig, data, length)
        if rows.time.size:
            streams[other.name] = Stream(other.name, rows, channel=other.channel)
    std = np.repeat(data.noise.mocap, 3)
    for name, b in data.bodies.items():
        rows = Rows("pose", b.time, np.full(b.time.size, b.arclength), b.poses, {})
        streams[name] = Stream(name, rows, True, std, b.mount, keep_repeats=True)
    recording = Recording("session", Path(), streams, robot, None)
    known = calibration.placed or data.frame is not None
    return recording if known else _in_unknown_frame(recording)


def _rows_of_coil(rig: Rig, data: RigData, length: float | None) -> tuple[Rows, Array]:
    """Rows of the calibrated coil that are on the robot, and its mount (4, 4).

    The distance of a fixed coil beyond the robot's end is added to the z of its mount.
    """
    time, mount = rig.true_time(data.coil_time), rig.whole_mount(data)
    arclength, inside = rig.arclength(time, data), rig.covered(time, data)
    if length is not None:
        low, high = ends_of(rig.channel(data), length)
        excess = arclength - np.clip(arclength, low, high)
        arclength = arclength - excess
        inside &= np.abs(excess) < (_OFF if data.slides else max(_OFF, 4 * data.coil_arclength_std))
        if not data.slides:
            mount = se3.exp(np.array([0.0, 0.0, excess.mean(), 0.0, 0.0, 0.0])) @ mount
    if not inside.any():
        raise RecordingError("No coil reading is on the robot while the slide ran; is it this rig?")
    poses = rig.T_wt @ data.coil[inside]
    return Rows("coil", time[inside], arclength[inside], poses, {}), mount


def _in_unknown_frame(recording: Recording) -> Recording:
    """Recording with the coils in the tracker's frame, which is marked as unknown."""
    streams = {
        name: stream if stream.truth else replace(stream, frame="tracker")
        for name, stream in recording.streams.items()
    }
    return replace(recording, streams=streams, unknown_frames=frozenset({"tracker"}))


def _with_stated_frame(calibration: Calibration, data: RigData) -> Rig:
    """Rig with the estimated frame, else the stated one, else the rig of the calibration."""
    if calibration.placed or data.frame is None:
        return calibration.rig
    return replace(calibration.rig, T_wt=data.frame)


def _rows_of(other: OtherCoil, rig: Rig, data: RigData, length: float | None) -> Rows:
    """Rows of an uncalibrated coil in the world, at true times and stated arclengths."""
    time = rig.true_time(other.time)
    if other.travel is None:  # slides with the calibrated coil, from its own arclength
        arclength = replace(rig, zero=other.arclength).arclength(time, data)
        inside = rig.covered(time, data)
    else:
        arclength, inside = other.arclength - other.travel, np.isfinite(other.travel)
    if length is not None:
        arclength = np.clip(arclength, *ends_of(other.channel, length))
    return Rows("coil", time[inside], arclength[inside], rig.T_wt @ other.poses[inside], {})
