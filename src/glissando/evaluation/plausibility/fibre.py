"""Check of fibres against tracked bodies: order of cores, mirrored or rotated angles, radii, signs.

The bending that a fibre measures is integrated from the base, and predicts the body's position.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, permutations

import numpy as np
from numpy.typing import NDArray

from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, poses_at, weights
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.grid import Grid
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import FbgReadings

_MOMENTS = 24  # times that are compared
_PLACES = 5  # gratings that a reading of a fibre must have, at least
_REACHED, _BEYOND = 0.3, 0.2  # over the length: least arclength of a body; gap without gratings
_OFF, _BENT = 0.05, 0.12  # miss beyond noise, over the length, and over the deflection
_BETTER, _EVEN = 0.2, 0.8  # ratio of misses: correction to none; best to an earlier one, which wins
_STEPS = 100  # integration steps along the body
_MANY = 4  # eccentric cores, beyond which only rotated and reversed orders are tried

Order = NDArray[np.intp]
"""Indices of rows or of cores."""


def check_fibres(streams: Streams) -> Iterator[Finding]:
    """Check that fibres predict the measured positions of tracked bodies.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    for r in streams.sensors:
        if isinstance(r, FbgReadings):
            seen = (_compared(streams, r, body) for body in _bodies(streams))
            yield from islice(filter(None, seen), 1)


def _bodies(streams: Streams) -> list[Readings]:
    """Tracked bodies with positions in the world, far from the base, the farthest first."""
    if not streams.robot.prior.fixes_base:
        return []
    unsure = {
        name for p in streams.robot.sensor_parameters
        if p.kind == "frame" and not p.known for name in p.streams
    }  # fmt: skip
    far = _REACHED * streams.robot.length
    bodies = [
        r for r in streams.tracked
        if weights(r)[0] > 0.0 and r.name not in unsure and r.arclength.min() > far
    ]  # fmt: skip
    return sorted(bodies, key=lambda r: -float(r.arclength.min()))


def _compared(streams: Streams, r: FbgReadings, body: Readings) -> Finding | None:
    """Finding that a fibre does not predict a body's position, with its cause; None if it does.

    None also if the data do not suffice, or if no known mistake explains the difference.
    """
    robot, length = streams.robot, streams.robot.length
    stamps = np.unique(r.time)
    moments = stamps[evenly_chosen(stamps.size, _MOMENTS)]
    place, pose, weight = poses_at(body, moments)
    base = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0])).pose[0, 0]
    rows = [np.flatnonzero(r.time == time) for time in moments]
    informed = [
        k for k in range(moments.size)
        if weight[k, 0] > 0.0 and np.unique(r.arclength[rows[k]]).size >= _PLACES
        and r.arclength[rows[k]].max() > place[k] - _BEYOND * length
    ]  # fmt: skip
    if not informed or np.linalg.matrix_rank(_slopes(r.core_radius, r.core_angle)) < 3:
        return None
    measured = (se3.inverse(base) @ pose)[informed, :3, 3]
    deflection = np.median(np.hypot(measured[:, 0], measured[:, 1]))
    misses = {}
    for cause, (inverse, order) in _interpretations(r).items():
        bends = [_curvatures(r, rows[k], inverse, order) for k in informed]
        ends = np.array(
            [_end_position(*each, place[k]) for each, k in zip(bends, informed, strict=True)]
        )
        misses[cause] = float(np.median(np.linalg.norm(ends - measured, axis=1)))
    miss = misses.pop("")
    least = min(misses.values())
    cause = next(c for c, other in misses.items() if _EVEN * other <= least)
    if miss < max(_OFF * length, _BENT * deflection) or misses[cause] > _BETTER * miss:
        return None
    return Finding(
        "fibre",
        f"{r.label!r} leads {1e3 * miss:.3g} mm away from where {body.label!r} is seen: {cause} "
        f"({1e3 * misses[cause]:.3g} mm then), or the frame of {body.label!r} is turned; give "
        f"core_radius and core_angle in the order of the columns, in metres and from x to y.",
        True, (r.label,), cause,
    )  # fmt: skip


def _slopes(radius: Array, angle: Array) -> Array:
    """Jacobian (C, 3) of the cores' strains by extension and two curvatures."""
    return np.stack([np.ones(len(radius)), radius * np.sin(angle), -radius * np.cos(angle)], -1)


def _inverse(radius: Array, angle: Array) -> Array:
    """Pseudoinverse (3, C) of the Jacobian `_slopes`."""
    return np.asarray(np.linalg.pinv(_slopes(radius, angle)), dtype=float)


def _interpretations(r: FbgReadings) -> dict[str, tuple[Array, Order]]:
    """Interpretations of a fibre by their mistake: pseudoinverse (3, C) and order (C,) of strains.

    The first, with an empty mistake, is the stated one; of equivalent ones the likelier comes
    first.
    """
    radius, angle = np.asarray(r.core_radius), np.asarray(r.core_angle)
    own, every = _inverse(radius, angle), np.arange(radius.size)
    out: dict[str, tuple[Array, Order]] = {"": (own, every)}
    mirrored = _inverse(radius, -angle)
    out["its core angles probably run from x to −y"] = mirrored, every
    out["its strains probably have the other sign"] = -own, every
    for turn, what in (np.pi / 2.0, "small"), (-np.pi / 2.0, "large"):
        turned = _inverse(radius, angle + turn)
        out[f"its core angles are probably 90 degrees too {what}"] = turned, every
    for factor in (0.5, 2.0, 0.1, 10.0, 1e-3, 1e3):
        scaled = _inverse(factor * radius, angle)
        out[f"its core radii should probably be {factor:g} times as large"] = scaled, every
    for order in _orders(np.flatnonzero(radius > 0.0)):
        moved = every.copy()
        moved[radius > 0.0] = order
        shown = ", ".join(str(core) for core in moved)
        out[f"its columns are probably of other cores, those of {shown} in turn"] = own, moved
    return out


def _orders(cores: Order) -> Iterator[Order]:
    """Yield permutations of cores; for many cores only rotations and reversals."""
    count = cores.size
    if count <= _MANY:
        yield from (cores[list(order)] for order in permutations(range(count)))
        return
    for way in (cores, cores[::-1]):
        yield from (np.roll(way, shift) for shift in range(count))


def _curvatures(r: FbgReadings, rows: Order, inverse: Array, order: Order) -> tuple[Array, Array]:
    """Arclengths (M,), m, and curvatures (M, 2), 1/m, from the rows of one time."""
    rows = rows[np.argsort(r.arclength[rows], kind="stable")]
    return r.arclength[rows], r.values[rows][:, order] @ inverse[1:].T


def _end_position(places: Array, bends: Array, end: float) -> Array:
    """Position (3,) in the base frame at an arclength, by integration of curvatures, untwisted."""
    step = end / _STEPS
    middle = step * (np.arange(_STEPS) + 0.5)
    strain = np.zeros((_STEPS, 6))
    strain[:, 2] = 1.0
    for axis in range(2):
        strain[:, 3 + axis] = np.interp(middle, places, bends[:, axis])
    pose = np.eye(4)
    for part in se3.exp(step * strain):
        pose = pose @ part
    out: Array = pose[:3, 3]
    return out
