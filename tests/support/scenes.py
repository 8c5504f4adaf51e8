"""Small scenes that several tests share: a robot, a motion, its readings."""

import numpy as np

from glissando import CoilReadings, GyroReadings, PoseReadings, estimate, load_robot, uniform_grid
from glissando.geometry import se3

LENGTH = 0.466


def arc(arclength, time):
    """Poses (M, 4, 4) of a constant-curvature arc whose bend and plane change with time."""
    arclength, time = np.broadcast_arrays(np.asarray(arclength, float), np.asarray(time, float))
    bend = 2.0 + np.sin(time)
    zero = np.zeros_like(time)
    strain = [zero, zero, zero + 1, bend * np.cos(0.5 * time), bend * np.sin(0.5 * time), zero]
    return se3.exp(arclength[..., None] * np.stack(strain, axis=-1))


def angular_velocity(arclength, time, step=1e-5):
    turn = se3.inverse(arc(arclength, time - step)) @ arc(arclength, time + step)
    return se3.log(turn)[..., 3:] / (2 * step)


def sliding_scene(seed=0, duration=1.0, nodes=4, rate=10.0):
    """Prior, grid and noisy readings: base pose, a sliding coil, a gyroscope."""
    rng = np.random.default_rng(seed)
    robot = load_robot("tdcr466")
    grid = uniform_grid(LENGTH, nodes, 0.0, duration, rate)
    time = np.linspace(0.0, duration, int(40 * duration) + 1)
    place = LENGTH - 0.06 * np.abs(np.sin(3 * time))
    noise = np.zeros((time.size, 6))
    noise[:, :5] = rng.standard_normal((time.size, 5)) * [7e-4, 7e-4, 7e-4, 6e-3, 6e-3]
    coil = CoilReadings(
        time=time,
        arclength=place,
        values=arc(place, time) @ se3.exp(noise),
        cov=[5e-7] * 3 + [4e-5] * 2,
        name="coil",
    )
    base = PoseReadings(
        time=time[::2],
        arclength=np.zeros(time[::2].size),
        values=se3.exp(1e-3 * rng.standard_normal((time[::2].size, 6))),
        cov=1e-6,
        name="base",
    )
    middle = np.full(time.size, LENGTH / 2)
    rate_seen = angular_velocity(middle, time) + 1e-2 * rng.standard_normal((time.size, 3))
    gyro = GyroReadings(time=time, arclength=middle, values=rate_seen, cov=1e-4, name="gyro")
    return robot.prior, grid, [base, coil, gyro]


def judged_scene():
    """A posterior, its readings with a drop-out of the coil, and true poses half way along."""
    prior, grid, readings = sliding_scene(duration=1.0)
    readings[1] = readings[1].select(np.abs(readings[1].time - 0.5) > 0.35)
    time = np.arange(0.0, 0.31, 0.05)
    place = np.full(time.size, LENGTH / 2)
    truth = PoseReadings(time=time, arclength=place, values=arc(place, time), cov=1e-6, name="seen")
    return estimate(prior, grid, readings), readings, [truth]
