"""Simulated session: streams of the sensors' readings, and the recording folder written of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.io.atomic import new_folder, write_table
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording_writer import write_streams
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_path import SlidePath
from glissando.model.tendons.channel import Channel
from glissando.simulation.bench import Bench
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.imperfections import Imperfections
from glissando.simulation.motion import Motion, shortening
from glissando.simulation.rod import Tendon
from glissando.simulation.session_truth import write_dynamics
from glissando.simulation.tracker import coil_rows, inertial_rows, mocap_rows

COIL_RATE, MOCAP_RATE, TENDON_RATE, INERTIAL_RATE = 40.0, 10.0, 5.0, 100.0  # Hz
_TENDON_STD = 5e-5  # m: errors of servos, and of friction
_LONGEST = 100_000.0  # s


@dataclass(frozen=True)
class Session(ShortRepr):
    """Simulated sensor readings of one run, with ground truth.

    Attributes:
        name: Name of the recording.
        duration: Duration of the recording, s.
        motion: True motion of the robot.
        path: Path of the slide.
        coil: Readings of the coil in the tracker's frame.
        mocap: Readings of motion capture in the world, by the name of the frame.
        T_wt: Pose of the tracker (4, 4).
        mocap_std: Standard deviation of motion capture's noise (6,), [linear m, angular rad].
        tendons: Displacements of the tendons, or None if they are not recorded.
        gyros: Readings of gyroscopes by name; empty for a quasi-static motion.
        accelerometers: Readings of accelerometers by name; empty for a quasi-static motion.
        inertial_std: Standard deviations of gyroscopes, rad/s, and accelerometers, m/s².
        channel: Channel beside the backbone in which the coil slides, or None.
    """

    name: str
    duration: float
    motion: Motion | DynamicMotion
    path: SlidePath
    coil: Rows
    mocap: dict[str, Rows]
    T_wt: Array
    mocap_std: Array
    tendons: Rows | None = None
    gyros: dict[str, Rows] = field(default_factory=dict)
    accelerometers: dict[str, Rows] = field(default_factory=dict)
    inertial_std: tuple[float, float] = (1.0, 1.0)
    channel: Channel | None = None

    def streams(self) -> list[Stream]:
        """All streams in the world frame, with truth marked, as arguments for `Recording.of`.

        Streams without stated noise have that of the robot file.
        """
        coil = self.coil.sensor.in_frame(self.coil.values, self.T_wt)
        rows = replace(self.coil, values=coil)
        return [
            replace(s, rows=rows, frame="world") if s.name == "coil" else s
            for s in self._recorded_streams
        ]

    @property
    def _recorded_streams(self) -> list[Stream]:
        """Streams as recorded, with the coil in the tracker's frame."""
        settings: dict[str, Any] = {"keep_repeats": True, "frame": "tracker"}
        streams = [Stream("coil", self.coil, channel=self.channel, **settings)]
        streams += [
            Stream(name, rows, True, self.mocap_std, keep_repeats=True)
            for name, rows in self.mocap.items()
        ]
        if self.tendons is not None:
            streams.append(Stream("tendons", self.tendons, std=np.array([_TENDON_STD])))
        inertial = self.gyros, self.accelerometers
        for every, std in zip(inertial, self.inertial_std, strict=True):
            streams += [Stream(name, rows, std=np.full(3, std)) for name, rows in every.items()]
        return streams


def simulate_session(
    bench: Bench,
    motion: Motion | DynamicMotion,
    path: SlidePath,
    *,
    seed: int,
    duration: float | None = None,
    flaws: Imperfections | None = None,
    name: str = "simulated",
    tendons: bool = False,
    channel: Channel | None = None,
) -> Session:
    """Simulate the readings of the bench's sensors during a motion and a slide of the coil.

    Random draws of the imperfections are independent: switching one off does not change the others.

    Args:
        bench: The robot with its sensors.
        motion: Motion of the robot.
        path: Path of the slide.
        seed: Seed of all noise, ≥ 0.
        duration: Duration of the session, s; by default until motion and path end.
        flaws: Imperfections; the bench's if None.
        name: Name of the session.
        tendons: Whether displacements of the tendons are recorded.
        channel: Channel beside the backbone in which the coil slides; None for the backbone.

    Raises:
        SimulationError: The duration or the seed is impossible, the coil would leave the robot, or
            imperfections are too large.
    """
    flaws = bench.flaws if flaws is None else flaws
    seconds = max(path.duration, float(motion.time[-1])) if duration is None else duration
    if not 1.0 / COIL_RATE <= seconds <= _LONGEST:
        raise SimulationError(
            f"A session of {seconds:g} s cannot be; give {1.0 / COIL_RATE:g} to {_LONGEST:,.0f} s."
        )
    if seed < 0:
        raise SimulationError(f"Seed {seed} cannot be; give a whole number from 0 up.")
    _require_coil_on_robot(bench, path)
    coil_noise, *mocap_noise, pull_noise = np.random.default_rng(seed).spawn(2 + bench.truth.size)
    time = np.arange(0.0, seconds + 1e-9, 1.0 / COIL_RATE)
    placement = bench.coil_offset, bench.tracker
    channel_tendon = Tendon.in_channel(channel, bench.rod.length) if channel else None
    coil = coil_rows(motion, path, time, *placement, flaws, coil_noise, channel_tendon)
    time = np.arange(0.0, seconds + 1e-9, 1.0 / MOCAP_RATE)
    mocap = {
        f"mocap_{1e3 * s:g}": mocap_rows(motion, float(s), time, flaws, noise)
        for s, noise in zip(bench.truth, mocap_noise, strict=True)
    }
    if not all(np.all(np.isfinite(rows.values)) for rows in (coil, *mocap.values())):
        raise SimulationError("Imperfections so large leave readings that are no numbers.")
    std = np.repeat(np.maximum([flaws.mocap, flaws.mocap_angle], 1e-6), 3) / np.sqrt(3.0)
    time = np.arange(0.0, seconds + 1e-9, 1.0 / TENDON_RATE)
    pulled = _tendon_rows(bench, motion, time, pull_noise) if tendons else None
    inertial = _inertial(bench, motion, seconds, flaws, seed)
    inertial_std = max(flaws.gyro, 1e-6), max(flaws.accelerometer, 1e-6)
    readings = coil, mocap, bench.tracker, std, pulled
    return Session(name, seconds, motion, path, *readings, *inertial, inertial_std, channel)


def _inertial(
    bench: Bench, motion: Motion | DynamicMotion, seconds: float, flaws: Imperfections, seed: int
) -> tuple[dict[str, Rows], dict[str, Rows]]:
    """Rows of gyroscopes and accelerometers by name; empty for a quasi-static motion."""
    gyros: dict[str, Rows] = {}
    accelerometers: dict[str, Rows] = {}
    if isinstance(motion, DynamicMotion):
        time = np.arange(0.0, seconds + 1e-9, 1.0 / INERTIAL_RATE)
        draws = np.random.default_rng([seed, 2]).spawn(bench.inertial.size)
        for s, noise in zip(bench.inertial, draws, strict=True):
            rows = inertial_rows(motion, float(s), time, flaws, noise)
            gyros[f"gyro_{1e3 * s:g}"], accelerometers[f"accelerometer_{1e3 * s:g}"] = rows
    return gyros, accelerometers


def _tendon_rows(
    bench: Bench, motion: Motion | DynamicMotion, time: Array, rng: np.random.Generator
) -> Rows:
    """Displacements of inextensible tendons as reported by servos, at times (M,)."""
    channels = np.array([tendon.channel() for tendon in bench.tendons]).T
    ends = np.array([tendon.end for tendon in bench.tendons])
    settings = dict(zip(("radius", "angle", "pitch"), channels, strict=True)) | {"end": ends}
    pulled = shortening(motion.mesh, motion.strains(time), bench.tendons)
    pulled = pulled + _TENDON_STD * rng.standard_normal(pulled.shape)
    return Rows("tendon", time, np.full(time.size, ends.max()), pulled, {}, settings)


def _require_coil_on_robot(bench: Bench, path: SlidePath) -> None:
    length = bench.rod.length
    farthest = float(path.at(path.time).max())
    if bench.coil_offset > 0.0 or length - farthest + bench.coil_offset < -1e-9:
        raise SimulationError(
            f"The coil would leave the robot: {length:g} m − {farthest:g} m of slide "
            f"{bench.coil_offset:+g} m of offset; slide less far."
        )


def write_session(session: Session, folder: Path, robot: str | Path, **more: Any) -> list[Path]:
    """Write a recording folder, completely or not at all; returns its files.

    `robot` is the name of a shipped robot or a robot file, which is copied into the folder; `more`
    are further fields of recording.toml. Raises SimulationError if the folder is not empty.
    """
    with new_folder(folder, SimulationError) as building:
        frames = {"tracker": session.T_wt}
        write_streams(
            building, session.name, session._recorded_streams, robot=robot, frames=frames, **more
        )
        path = session.path
        knots = np.column_stack([path.time, path.displacement, path.speed])
        write_table(building / "slide_path.csv", ["time", "displacement", "speed"], knots)
        if isinstance(session.motion, DynamicMotion):
            write_dynamics(session.motion, building)
    return sorted(folder.iterdir())
