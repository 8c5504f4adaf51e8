"""The result of a calibration: numbers, a TOML file, and its application to a session."""

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

_OF_PLACE = "frame", "mount", "tracker"  # constants that motion capture shows
_OFF = 1e-3  # m beyond the robot's ends, from which on a sliding coil is not on it
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
        log_odds: Log odds of the direction; infinite where only one is possible.
        fits: Residuals of each stream.
        warnings: Sentences on what the session does not show.
        tube: What a body on the sliding tube says of the slide, if there was one.
        channel: The channel beside the backbone that was found, if the coil slides in one; the
            mount's x and y are then those of the channel less the stated one's.
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
        """Whether the tracker's place was found, which takes motion capture."""
        return bool(np.any(self.std[:6] < ANYWHERE))

    def values(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation by parameter; the frame as position and rotation vector.

        Both of the frame are in the world, where `std` is of errors on the tracker's own axes.
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
        """Name, value, standard deviation and unit of what was found, in mm, mrad, ms or ppm."""
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
        """The channel that was found, and how far (x, y) it is from the stated one, m."""
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
        """Mount (4, 4) of the coil in the cross-section, or in the channel that was found."""
        return self.rig.coil_mount if self.channel is None else self.rig.tilt

    def sensor_parameters(self) -> tuple[SensorParameter, ...]:
        """Frame, mount and delay of the coil as known sensor parameters for a robot file.

        They are for recordings whose coil is in the tracker's frame and time but has arclengths.
        There are none where the tracker's place was not found.
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
        """Write the TOML file that `load_calibration` reads, laid out as docs/calibration.md."""
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
        GlissandoError: If the file cannot be read, with the key that is wrong.
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
        A recording of the coil at true times and arclengths with its mount; what it repeats of a
        tracker that is frozen is left out when it is read. Readings while the
        slide was not recorded, or a millimetre or more off the robot, are left out; a fixed coil
        that is found ahead of the robot's end is mounted so far ahead of it. The tracker's
        other coils come along, at true times and where they are stated to be. Where the
        calibration did not find the tracker's frame, it is the stated one, else unknown.

    Raises:
        RecordingError: If no coil reading is left.
    """
    rig, length = _in_frame(calibration, data), None if robot is None else robot.length
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
    made = Recording("session", Path(), streams, robot, None)
    return made if calibration.placed or data.frame is not None else _unplaced(made)


def _rows_of_coil(rig: Rig, data: RigData, length: float | None) -> tuple[Rows, Array]:
    """Rows of the calibrated coil that are on the robot, and its mount (4, 4).

    What a fixed coil is found beyond the robot's end is how far its mount puts it ahead of there.
    """
    time, mount = rig.true_time(data.coil_time), rig.whole_mount(data)
    arclength, inside = rig.arclength(time, data), rig.covered(time, data)
    if length is not None:
        low, high = ends_of(rig.channel(data), length)
        beyond = arclength - np.clip(arclength, low, high)
        arclength = arclength - beyond
        inside &= np.abs(beyond) < (_OFF if data.slides else max(_OFF, 4 * data.coil_arclength_std))
        if not data.slides:
            mount = se3.exp(np.array([0.0, 0.0, beyond.mean(), 0.0, 0.0, 0.0])) @ mount
    if not inside.any():
        raise RecordingError("No coil reading is on the robot while the slide ran; is it this rig?")
    poses = rig.T_wt @ data.coil[inside]
    return Rows("coil", time[inside], arclength[inside], poses, {}), mount


def _unplaced(recording: Recording) -> Recording:
    """The recording with the coils in the tracker's frame, whose place is not known."""
    streams = {
        name: stream if stream.truth else replace(stream, frame="tracker")
        for name, stream in recording.streams.items()
    }
    return replace(recording, streams=streams, unknown_frames=frozenset({"tracker"}))


def _in_frame(calibration: Calibration, data: RigData) -> Rig:
    """The rig with the frame that was found, else the stated one, else the tracker's own."""
    if calibration.placed or data.frame is None:
        return calibration.rig
    return replace(calibration.rig, T_wt=data.frame)


def _rows_of(other: OtherCoil, rig: Rig, data: RigData, length: float | None) -> Rows:
    """Rows of another coil in the world at true times, where it is stated, on the robot."""
    time = rig.true_time(other.time)
    if other.travel is None:  # it slides as the calibrated one does, from a place of its own
        arclength = replace(rig, zero=other.arclength).arclength(time, data)
        inside = rig.covered(time, data)
    else:
        arclength, inside = other.arclength - other.travel, np.isfinite(other.travel)
    if length is not None:
        arclength = np.clip(arclength, *ends_of(other.channel, length))
    return Rows("coil", time[inside], arclength[inside], rig.T_wt @ other.poses[inside], {})
