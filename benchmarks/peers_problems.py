"""Problems on which estimators of static shapes are compared."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import shapes
from glissando import load_robot
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording

SPACETIME = Path("../shared/data/spacetime")
READ = [3, 6, 9, 12]  # stations of the steel rod that are read, its tip the last


@dataclass(frozen=True)
class Problem:
    """Shapes to estimate: poses read and true positions to predict, with a shape index per row.

    `base_std` is the standard deviation of every shape's base about `base_pose`, 0 if the base is
    read instead. `stations` are all arclengths read or queried, and the base; `true_std` is the
    standard deviation of the truth's errors.
    """

    name: str
    count: int
    stations: np.ndarray
    base_pose: np.ndarray
    base_std: float
    reading_shape: np.ndarray
    reading_arclength: np.ndarray
    reading_pose: np.ndarray
    query_shape: np.ndarray
    query_arclength: np.ndarray
    query_position: np.ndarray
    true_std: float

    @property
    def nodes(self):
        """Arclengths of the base and the readings: sufficient nodes, as transitions are exact."""
        return np.union1d(0.0, self.reading_arclength.round(9))

    def first(self, count):
        """Problem with the first `count` shapes only."""
        rows = {"reading": self.reading_shape < count, "query": self.query_shape < count}
        parts = {}
        for name, values in vars(self).items():
            kind = name.split("_")[0]
            parts[name] = values[rows[kind]] if kind in rows else values
        return Problem(**parts | {"count": count})


@dataclass(frozen=True)
class Numbers:
    """Density of strain, variance of the base's strain, and std of a reading, (6,) each."""

    psd: np.ndarray
    base_strain: np.ndarray
    noise: np.ndarray

    @staticmethod
    def of(logs):
        """Numbers of decimal logarithms (8,): [linear, bending, torsion] twice, then noise."""
        spread = np.power(10.0, logs)
        six = [0, 0, 0, 1, 1, 2]
        return Numbers(spread[:3][six], spread[3:6][six], spread[6:][[0, 0, 0, 1, 1, 1]])


ROD_NOISE = np.log10([0.7e-3, np.radians(0.4)])


def steel_rods(numbers):
    """Problem of numbered shapes of the steel rod, with four noisy poses each, seeded by number."""
    poses, s = shapes.load_shapes(), shapes.STATIONS
    queried = np.setdiff1d(np.arange(1, s.size), READ)
    read = []
    for number in numbers:
        noise = np.power(10.0, ROD_NOISE)[[0, 0, 0, 1, 1, 1]]
        noise_twist = noise * np.random.default_rng(number).standard_normal((len(READ), 6))
        read.append(poses[number, READ] @ se3.exp(noise_twist))
    count = len(numbers)
    return Problem(
        "steel rod",
        count,
        s,
        poses[0, 0],
        1e-5,
        np.repeat(np.arange(count), len(READ)),
        np.tile(s[READ], count),
        np.concatenate(read),
        np.repeat(np.arange(count), queried.size),
        np.tile(s[queried], count),
        poses[list(numbers)][:, queried][..., :3, 3].reshape(-1, 3),
        shapes.ROUNDING,
    )


def recorded(name, window, step):
    """Problem of single times of a public recording: tracker readings nearest to each time."""
    recording = load_recording(SPACETIME / name)
    robot = load_robot("tdcr466")
    sites = ["vicon1", "vicon2", "vicon3"]
    (base, tip), _ = recording.readings(["aurora0", "aurora1"], robot, window)
    truth, _ = recording.readings(sites, robot, window, as_truth=True)
    moments = np.arange(window[0] + 0.5, window[1] - 0.5, step)
    near = [np.abs(r.time[:, None] - moments).argmin(axis=0) for r in (base, tip, *truth)]
    read = np.stack([base.values[near[0]], tip.values[near[1]]], axis=1)
    seen = np.stack(
        [t.values[rows, :3, 3] for t, rows in zip(truth, near[2:], strict=True)], axis=1
    )
    count, places = moments.size, np.array([t.arclength[0] for t in truth])
    every = np.arange(count)
    return Problem(
        "real robot",
        count,
        np.concatenate([[0.0], places, [robot.length]]),
        base.values[near[0][0]],
        0.0,
        np.repeat(every, 2),
        np.tile([0.0, robot.length], count),
        read.reshape(-1, 4, 4),
        np.repeat(every, places.size),
        np.tile(places, count),
        seen.reshape(-1, 3),
        1e-4,
    )


TUNED_ON = {
    "steel rod": lambda: steel_rods(range(0, 250, 4)),
    "real robot": lambda: recorded("slow_free_space", (0.0, 45.0), 0.5),
}
REPORTED_ON = {
    "steel rod": lambda: steel_rods(range(250, 500)),
    "real robot": lambda: recorded("fast_contact", (10.0, 30.0), 0.1),
}
