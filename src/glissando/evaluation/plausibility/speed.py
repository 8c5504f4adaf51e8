"""Checks for motion too fast for a robot, and for time grids far finer than the readings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, as_poses, weights

_NEAR = 0.1  # largest distance along the robot over its length, of readings used for speeds
_SPEED = 6.0  # robot lengths per second, largest plausible median speed
_TURN = 30.0  # rad/s, largest plausible median rotation rate
_NODES = 8.0  # largest plausible number of time nodes per time of readings
_MANY = 1500  # time nodes that are always accepted


def check_speed(streams: Streams) -> Iterator[Finding]:
    """Check the median speed and rotation rate of trackers.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    for r in streams.tracked:
        steps, near = np.diff(r.time), np.abs(np.diff(r.arclength)) < _NEAR * streams.robot.length
        pose, ok = as_poses(r), (steps > 0.0) & near  # a stream may read many places at a time
        if len(r) < 16 or not np.any(ok):
            continue
        if weights(r)[0] > 0.0:
            moved = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)[ok] / steps[ok]
            speed = float(np.median(moved))
            if speed > _SPEED * streams.robot.length:
                yield Finding(
                    "speed",
                    f"{r.label!r} moves at {speed:.3g} m/s half of the time, on a robot "
                    f"{streams.robot.length:g} m long: its times or positions probably have "
                    f"another unit; give seconds and metres.",
                    True, (r.label,),
                )  # fmt: skip
                continue
        if weights(r)[3] > 0.0:
            turned = np.linalg.norm(np.diff(pose[:, :3, 2], axis=0), axis=1)[ok] / steps[ok]
            rate = float(np.median(turned))
            if rate > _TURN:
                yield Finding(
                    "speed",
                    f"{r.label!r} turns at {rate:.3g} rad/s half of the time: its times probably "
                    f"have another unit, or its rotations are mixed up; give seconds.",
                    True, (r.label,),
                )  # fmt: skip


def check_grid(streams: Streams, window: tuple[float, float]) -> Iterator[Finding]:
    """Check for a grid with far more time nodes than times of readings.

    Args:
        streams: Streams of a session.
        window: First and last time to estimate, s.

    Yields:
        At most one finding.
    """
    robot = streams.robot
    nodes = (window[1] - window[0]) * robot.time_rate
    moments = np.unique(np.concatenate([r.time for r in streams.sensors])).size
    if nodes > max(_NODES * moments, _MANY):
        yield Finding(
            "grid",
            f"{window[0]:g} to {window[1]:g} s at time_rate = {robot.time_rate:g} nodes a second "
            f"are {nodes:,.0f} time nodes for {moments:,} moments of readings, and "
            f"{robot.memory(nodes) / 1e9:.2g} GB: time_rate or the times of a stream probably "
            f"have another unit; give nodes a second and seconds, or choose a shorter window.",
            True,
        )  # fmt: skip
