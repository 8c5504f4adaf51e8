"""Input of the guard's checks: a robot, its streams, and the streams' frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from glissando.evaluation.plausibility.shape import TrackedPoses
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings

_MOMENTS = 12  # times at which shapes are fitted
_NEAR = 0.25  # s, largest distance in time of a reading that is interpolated


@dataclass(frozen=True)
class Streams:
    """Streams of one session, corrected by sensor parameters.

    Attributes:
        robot: The robot.
        sensors: Streams to estimate from.
        truth: Truth streams.
        frames: Poses T_wf (4, 4) of the frames of streams, by name; others are in the world frame.
    """

    robot: Robot
    sensors: tuple[Readings, ...]
    truth: tuple[Readings, ...] = ()
    frames: Mapping[str, Array] = field(default_factory=dict)

    @property
    def every(self) -> tuple[Readings, ...]:
        """Streams of sensors, then of truth."""
        return self.sensors + self.truth

    @property
    def tracked(self) -> list[Readings]:
        """Streams of positions or orientations that are not empty."""
        return [r for r in self.every if r.tracker and len(r)]

    def frame(self, r: Readings) -> Array:
        """Pose (4, 4) of the frame of a stream in the world."""
        return self.frames.get(r.name, np.eye(4))

    def moments(self, count: int = _MOMENTS) -> tuple[Array, TrackedPoses]:
        """Times (B,), s, spread over the session, and the poses of each tracked stream then."""
        tracked = self.tracked
        spans = np.array([[r.time.min(), r.time.max()] for r in tracked])
        first, last = spans[:, 0].max(), spans[:, 1].min()
        if not first < last:
            first, last = spans[:, 0].min(), spans[:, 1].max()
        time = np.linspace(first, last, count + 2)[1:-1]
        seen = [poses_at(r, time) for r in tracked]
        return time, TrackedPoses(*(np.stack(part, axis=1) for part in zip(*seen, strict=True)))


def poses_at(r: Readings, time: Array) -> tuple[Array, Array, Array]:
    """Arclengths (B,), poses (B, 4, 4) of cross-sections and weights (B, 4) of a stream at times.

    Poses are interpolated between readings; if none is near, the weights are zero.
    """
    order = np.argsort(r.time, kind="stable")
    stamps = r.time[order]
    after = np.clip(np.searchsorted(stamps, time), 1, max(len(r) - 1, 1))
    lower, upper = order[after - 1], order[np.minimum(after, len(r) - 1)]
    gap = np.maximum(r.time[upper] - r.time[lower], 1e-12)
    share = np.clip((time - r.time[lower]) / gap, 0.0, 1.0)
    poses = as_poses(r)
    start, end = poses[lower], poses[upper]
    pose = start @ se3.exp(share[:, None] * se3.log(se3.inverse(start) @ end))
    place = (1.0 - share) * r.arclength[lower] + share * r.arclength[upper]
    near = np.minimum(np.abs(time - r.time[lower]), np.abs(time - r.time[upper])) < _NEAR
    return place, pose, near[:, None] * weights(r)


def as_poses(r: Readings) -> Array:
    """Poses (M, 4, 4) of the cross-section by a tracker; components not measured are identity."""
    out = np.tile(np.eye(4), (len(r), 1, 1))
    if r.values.ndim == 2:
        out[:, :3, 3] = r.values
        return out
    out[:, :3, :3] = r.values[:, :3, :3]
    if r.values.shape[-1] == 4:
        out[:, :3, 3] = r.values[:, :3, 3]
    return out @ se3.inverse(r.mount)


def weights(r: Readings) -> Array:
    """Weights (4,), 0 or 1, of a tracker's position and of its three axes, by its kind."""
    if r.values.ndim == 2:
        return np.array([1.0, 0.0, 0.0, 0.0])
    if r.values.shape[-1] == 3:
        return np.array([0.0, 1.0, 1.0, 1.0])
    return np.array([1.0, 0.0, 0.0, 1.0] if r.kind == "coil" else [1.0, 1.0, 1.0, 1.0])
