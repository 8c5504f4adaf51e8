"""Simulated readings of an electromagnetic coil on a slide, motion capture and inertial sensors.

Most of a tracker's error is not white: it depends on the coil's position in the field, so repeated
readings at one place do not average it out.
"""

from __future__ import annotations

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows
from glissando.model.slide_path import SlidePath
from glissando.simulation.channel import poses_in, straight_length
from glissando.simulation.drive_tube import STEP, DriveTube
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.imperfections import Imperfections, SmoothField
from glissando.simulation.motion import Motion
from glissando.simulation.rod import Tendon

_EXPOSED = (np.arange(5) + 0.5) / 5.0  # fractions of an exposure at which the pose is sampled


def coil_rows(
    motion: Motion | DynamicMotion,
    path: SlidePath,
    time: Array,
    offset: float,
    T_wt: Array,
    flaws: Imperfections,
    rng: np.random.Generator,
    channel: Tendon | None = None,
) -> Rows:
    """Simulate the readings of a coil on the slide.

    Args:
        motion: Motion of the robot.
        path: Path of the slide.
        time: Times of the readings (M,), s.
        offset: Arclength of the coil minus the robot's length at displacement zero, m.
        T_wt: Pose of the tracker (4, 4).
        flaws: Imperfections of the coil and its slide.
        rng: Random generator.
        channel: Channel beside the backbone in which the coil slides, or None; rows then have the
            distance along the channel from the base as arclength.

    Returns:
        Rows in the tracker's frame without drop-outs, at arclengths by the motor's encoder.
    """
    streams = iter(rng.spawn(7))  # one per part: switching a part off does not change the others
    commanded = path.at(time)
    encoded = commanded + flaws.encoder * next(streams).standard_normal(time.size)
    length = motion.rod.length
    longest = straight_length(channel, length) if channel else length
    encoded_place = np.clip(longest - encoded + offset, 0.0, longest)
    shares = _EXPOSED if flaws.exposure > 0.0 else np.zeros(1)
    exposed = (time[:, None] - flaws.latency - flaws.exposure * shares).ravel()
    place = np.clip(longest - _coil_at(path, exposed, flaws) + offset, 0.0, longest)
    pose = poses_in(channel, motion, place, exposed) if channel else motion.at(place, exposed).pose
    pose = pose @ _clearance_poses(next(streams), place, flaws.play)
    pose = _mean_poses(pose.reshape(time.size, shares.size, 4, 4))
    pose = pose @ se3.exp(_tracker_error(next(streams), next(streams), pose, flaws))
    centre = se3.pose(np.eye(3), np.asarray(flaws.field_centre))
    slip = centre @ se3.exp(_registration(next(streams), flaws)) @ se3.inverse(centre)
    reported = rolled(se3.inverse(T_wt) @ slip @ pose, flaws.roll, next(streams))
    received = _outside_dropouts(next(streams), time, flaws)
    return Rows("coil", time[received], encoded_place[received], reported[received], {})


def _coil_at(path: SlidePath, time: Array, flaws: Imperfections) -> Array:
    """Displacements (M,) of the coil, with play and drive tube, at times (M,) in any order."""
    sequence = np.sort(time)
    back = np.searchsorted(sequence, time)
    if flaws.drive_stiffness <= 0.0:
        return _with_backlash(path.at(sequence), flaws.backlash)[back]
    tube = DriveTube(
        flaws.drive_stiffness,
        flaws.drive_mass,
        flaws.drive_damping,
        flaws.drive_friction,
        flaws.drive_stiction,
    )
    fine = np.arange(sequence[0], sequence[-1] + 2.0 * STEP, STEP)
    return np.interp(time, fine, tube.follow(_with_backlash(path.at(fine), flaws.backlash)))


def _mean_poses(poses: Array) -> Array:
    """Mean poses (M, 4, 4) of J close poses (M, J, 4, 4) each."""
    if poses.shape[1] == 1:
        return poses[:, 0]
    first = poses[:, :1]
    return first[:, 0] @ se3.exp(np.mean(se3.log(se3.inverse(first) @ poses), axis=1))


def _with_backlash(commanded: Array, width: float) -> Array:
    """Displacements (M,) of a coil that follows the motor with a play of `width` metres."""
    motor, play = commanded.tolist(), 0.5 * width
    coil = motor[:1]
    for target in motor[1:]:
        coil.append(min(max(coil[-1], target - play), target + play))
    return np.array(coil)


def _clearance_poses(rng: np.random.Generator, arclength: Array, clearance: float) -> Array:
    """Poses (M, 4, 4) of the inner tube in the outer one, in contact along a smooth random line."""
    around = SmoothField.draw(rng, 1, 1, 0.15)
    start = rng.uniform(0.0, 2.0 * np.pi)

    def touch(s: Array) -> Array:
        angle = start + 2.0 * around(s[:, None])[:, 0]
        return clearance * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)

    slope = (touch(arclength + 1e-5) - touch(arclength - 1e-5)) / 2e-5
    lean = np.stack([-slope[:, 1], slope[:, 0], np.zeros(arclength.size)], axis=-1)
    return se3.pose(se3.so3_exp(lean), touch(arclength))


def _tracker_error(
    white: np.random.Generator, spatial: np.random.Generator, pose: Array, flaws: Imperfections
) -> Array:
    """Twists (M, 6) of the tracker's white noise and bias."""
    noise = white.standard_normal((len(pose), 5))
    return error_twists(noise, SmoothField.draw(spatial, 3, 5, flaws.bias_length), pose, flaws)


def error_twists(noise: Array, field: SmoothField, pose: Array, flaws: Imperfections) -> Array:
    """Twists (M, 6) of the tracker's errors at poses (M, 4, 4), without roll, which is unobserved.

    White `noise` (M, 5) and the bias `field` have unit variance and are scaled by `flaws`.
    """
    place = pose[:, :3, 3]
    white, bias = np.zeros((2, len(pose), 6))
    white[:, :5], bias[:, :5] = noise, field(place)
    size = np.repeat(np.sqrt([1.0 / 3.0, 1.0 / 2.0]), 3)
    white *= size * np.repeat([flaws.jitter, flaws.jitter_angle], 3)
    bias *= size * np.repeat([flaws.bias, flaws.bias_angle], 3)
    distance = np.linalg.norm(place - flaws.field_centre, axis=1, keepdims=True)
    # white noise is isotropic, so its axes do not matter; bias is a field in world axes
    bias[:, :3] = np.einsum("mji,mj->mi", pose[:, :3, :3], bias[:, :3])
    return (1.0 + (distance / flaws.field_size) ** 2) * (white + bias)


def _registration(rng: np.random.Generator, flaws: Imperfections) -> Array:
    error = rng.standard_normal(6) / np.sqrt(3.0)
    return error * np.repeat([flaws.registration, flaws.registration_angle], 3)


def rolled(pose: Array, roll: str, rng: np.random.Generator) -> Array:
    """Poses (M, 4, 4) in the tracker's frame with the reported roll, see `Imperfections.roll`."""
    if roll == "true":
        return pose
    if roll == "arbitrary":
        turn = np.zeros(6)
        turn[5] = rng.uniform(-np.pi, np.pi)
        return pose @ se3.exp(turn)
    axis = pose[:, :3, 2]  # least rotation from the tracker's z to the coil's
    out = np.array(pose)
    out[:, :3, :3] = se3.least_turn(axis)
    return out


def _outside_dropouts(rng: np.random.Generator, time: Array, flaws: Imperfections) -> np.ndarray:
    """Mask (M,) or indices of the rows outside drop-outs; at least one row is kept."""
    received = np.ones(time.size, dtype=bool)
    span = float(np.ptp(time))
    for start in rng.uniform(time[0], time[-1], rng.poisson(flaws.dropouts * span)):
        received &= ~((time >= start) & (time < start + rng.uniform(*flaws.dropout_duration)))
    return received if received.any() else np.arange(time.size) == 0


def mocap_rows(
    motion: Motion | DynamicMotion,
    arclength: float,
    time: Array,
    flaws: Imperfections,
    rng: np.random.Generator,
) -> Rows:
    """Simulate motion capture of the frame at one arclength (m), at times (M,), in the world."""
    place = np.full(time.size, arclength)
    noise = rng.standard_normal((time.size, 6)) / np.sqrt(3.0)
    noise *= np.repeat([flaws.mocap, flaws.mocap_angle], 3)
    return Rows("pose", time, place, motion.at(place, time).pose @ se3.exp(noise), {})


def inertial_rows(
    motion: DynamicMotion,
    arclength: float,
    time: Array,
    flaws: Imperfections,
    rng: np.random.Generator,
) -> tuple[Rows, Rows]:
    """Simulate a gyroscope and an accelerometer at one arclength (m), aligned with the body.

    Returns:
        Angular velocities, rad/s, and specific forces (acceleration minus gravity), m/s².
    """
    place = np.full(time.size, arclength)
    at, noise = motion.at(place, time), rng.standard_normal((2, time.size, 3))
    spin = at.velocity[:, 3:] + flaws.gyro * noise[0]
    force = at.specific_force + flaws.accelerometer * noise[1]
    settings = {
        "gravity": np.asarray(motion.acting.scenario.gravity, dtype=float),
        "span": np.full(1, float(np.diff(time[:2])[0])),
    }
    gyro = Rows("gyro", time, place, spin, {})
    return gyro, Rows("accelerometer", time, place, force, {}, settings)
