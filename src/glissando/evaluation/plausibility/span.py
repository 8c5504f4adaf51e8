"""Check of the lengths between tracked bodies by their poses against their arclengths."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.plausibility.session import Streams
from glissando.evaluation.plausibility.shape import largest_extension
from glissando.geometry.se3 import Array

_APART = 0.1, 0.36  # range of distances over the robot's length, with nearly constant curvature
_FEWEST = 3  # least number of pairs
_MOMENTS = 40
_OFF = 0.15  # tolerated deviation of the ratio of lengths from one, plus extension
_STRETCHES = 2.0  # standard deviations of the robot's extension that are tolerated


def check_span(streams: Streams) -> Iterator[Finding]:
    """Check for arclengths that differ by a common factor from the lengths between poses.

    An arc with chord c whose tangents at both ends differ by θ has length c θ / (2 sin θ/2).

    Args:
        streams: Streams of a session.

    Yields:
        At most one finding.
    """
    tracked = [
        (j, r) for j, r in enumerate(streams.tracked) if np.ptp(r.arclength) < 1e-3 and len(r) > 1
    ]
    robot = streams.robot
    near, far = (share * robot.length for share in _APART)
    pairs = [
        (a, b) for a, b in combinations(tracked, 2)
        if near < abs(b[1].arclength[0] - a[1].arclength[0]) < far
    ]  # fmt: skip
    if len(pairs) < _FEWEST:
        return
    _, seen = streams.moments(_MOMENTS)
    stretches = []
    for (a, one), (b, other) in pairs:
        both = np.min(seen.weight[:, [a, b]], axis=(1, 2)) > 0.0
        if both.sum() > 1:
            length = _arc(seen.pose[both, a], seen.pose[both, b])
            ratio = float(np.median(length)) / abs(float(other.arclength[0] - one.arclength[0]))
            stretches.append((ratio, one, other))
    if len(stretches) < _FEWEST:
        return
    stretches.sort(key=lambda each: each[0])
    ratio, one, other = stretches[len(stretches) // 2]
    if abs(ratio - 1.0) < _OFF + _STRETCHES * largest_extension(robot):
        return
    names = tuple(dict.fromkeys(r.label for _, *pair in stretches for r in pair))
    stated = abs(float(other.arclength[0] - one.arclength[0]))
    yield Finding(
        "length-unit",
        f"Between {one.label!r} and {other.label!r} the robot is {1e3 * ratio * stated:.3g} mm "
        f"long by their poses and {1e3 * stated:.3g} mm by their arclengths, and likewise between "
        f"others of {listed(names)}: the robot's length and the arclengths are probably "
        f"{1.0 / ratio:.2g} times what they should be; measure them along the robot, in metres. "
        f"If it stretches so, the prior of the robot file has to say it.",
        False, names, "arclengths",
    )  # fmt: skip


def _arc(start: Array, end: Array) -> Array:
    """Lengths (B,) of arcs between poses (B, 4, 4)."""
    chord = np.linalg.norm(end[:, :3, 3] - start[:, :3, 3], axis=-1)
    bend = 0.5 * np.arccos(np.clip(np.sum(start[:, :3, 2] * end[:, :3, 2], axis=-1), -1.0, 1.0))
    return chord / np.sinc(bend / np.pi)
