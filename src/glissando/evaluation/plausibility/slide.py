"""Check of sliding sensors: their motion along their axis must equal the travel of the slide."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from glissando.evaluation.plausibility.corrections import reordered, signed_axes
from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, as_poses, weights
from glissando.evaluation.plausibility.shape import largest_extension
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings

_TRAVEL = 5e-3  # m, least travel of a slide for a check
_STEP = 0.2  # s, time steps over which motion and travel are compared
_DRIFT = 0.75  # terms per second of the polynomial that models the robot's own motion
_CLEAR = 0.35  # least share of the motion's variance that the slide must explain
_STD = 8.0  # standard deviations by which a scale must differ from one
_TILT = 0.12  # rad, tolerated angle between motion and axis
_GOOD = 0.03  # unexplained share of the motion, below which no lag is searched
_LATE = np.arange(-1.5, 1.5001, 0.1)  # s, lags that are tried
_FAR = 0.03  # motion along the axis over the robot's length, tolerated without a slide
_AXIAL = 0.97  # share of the motion along the axis, beyond which a sensor slides


@dataclass(frozen=True)
class _SlideMotion:
    """Motion of a sliding sensor over M time steps.

    Attributes:
        moved: Displacements (M, 3) in the world, m.
        rotation: Rotations (M, 3, 3) in the middle of the steps.
        travel: Travels (M,) of the slide, m, with times shifted by its assumed lag.
        drift: Basis functions (M, D) of time for the robot's own motion.
    """

    moved: Array
    rotation: Array
    travel: Array
    drift: Array

    def along(self, rotation: Array, moved: Array) -> tuple[Array, Array, float, float]:
        """Motion in the body frame per travel (3,), its std (3,), and two unexplained shares.

        The shares of the motion's variance are unexplained by the fit, and by unit motion along z.
        """
        keep = self.drift @ np.linalg.pinv(self.drift)

        def without_drift(values: Array) -> Array:
            return values - np.einsum("mn,n...->m...", keep, values)

        columns = without_drift(rotation * self.travel[:, None, None]).reshape(-1, 3)
        target = without_drift(moved).reshape(-1)
        direction = np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0], dtype=float)
        error = target - columns @ direction
        left = float(np.sum(error**2))
        freedom = max(target.size - 3 * self.drift.shape[1] - 3, 1)
        ahead, behind = (
            error[3:],
            error[:-3],
        )  # residuals of the robot's motion are correlated
        rho = np.clip(np.sum(ahead * behind) / max(np.sum(error**2), 1e-30), 0.0, 0.95)
        cov = np.linalg.pinv(columns.T @ columns) * left / freedom * (1.0 + rho) / (1.0 - rho)
        std: Array = np.sqrt(np.diagonal(cov))
        whole = max(float(np.sum(target**2)), 1e-30)
        straight = float(np.sum((target - columns[:, 2]) ** 2))
        return direction, std, left / whole, straight / whole


def check_slide(streams: Streams) -> Iterator[Finding]:
    """Check sensors whose arclength changes, and sensors that slide at constant arclength.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    for r in streams.tracked:
        if weights(r)[0] == 0.0 or weights(r)[3] == 0.0:
            continue
        fixed = np.ptp(r.arclength) < _TRAVEL
        if fixed and not any(r is sensor for sensor in streams.sensors):
            continue
        finding = _unstated_slide(r, streams) if fixed else _judged(r, streams.frame(r))
        if finding is not None:
            yield finding


def _unstated_slide(r: Readings, streams: Streams) -> Finding | None:
    """Finding that a sensor slides along its axis although its arclength is constant."""
    motion = _slide_motion(r)
    if motion is None:
        return None
    body = np.einsum("mji,mj->mi", motion.rotation, motion.moved)
    path = np.cumsum(body, axis=0)
    span = np.ptp(path, axis=0)
    energy = np.mean(body**2, axis=0)
    if span[2] < _FAR * streams.robot.length or energy[2] < _AXIAL * energy.sum():
        return None
    if 2.0 * largest_extension(streams.robot) * streams.robot.length > span[2]:
        return None
    place = float(np.median(r.arclength))
    remedy = (
        "it probably slides; give every row the arclength of the slide."
        if place > _FAR * streams.robot.length
        else "the base probably moves; in [base] give var_pose the squares of how far it does."
    )
    return Finding(
        "slide",
        f"{r.label!r} moves {span[2]:.3g} m along its own axis, and hardly sideways, while its "
        f"arclength stays at {place:.3g} m: {remedy}",
        False, (r.label,), "unmoved",
    )  # fmt: skip


def _slide_motion(r: Readings, late: float = 0.0) -> _SlideMotion | None:
    """Motion of a stream, its slide's travel read `late` seconds earlier; None if too short."""
    order = np.argsort(r.time, kind="stable")
    time, place, pose = r.time[order], r.arclength[order], as_poses(r)[order]
    grid = np.arange(time[0], time[-1], _STEP)
    if not grid.size:
        return None
    at = np.searchsorted(time, grid).clip(0, time.size - 1)
    at = at[np.append(True, np.diff(at) > 0)]
    ends = at[1:]
    starts = at[:-1]
    span = time[ends] - time[starts]
    ok = span < 2.0 * _STEP
    if ok.sum() < 12:
        return None
    starts, ends, span = starts[ok], ends[ok], span[ok]
    moved = pose[ends, :3, 3] - pose[starts, :3, 3]
    middle = (starts + ends) // 2
    travel = np.interp(time[ends] - late, time, place) - np.interp(time[starts] - late, time, place)
    count = int(np.clip(np.ptp(time) * _DRIFT, 4, 12))
    x = 2.0 * (time[middle] - time[0]) / max(np.ptp(time), 1e-9) - 1.0
    drift = np.polynomial.chebyshev.chebvander(x, count - 1) * span[:, None]
    return _SlideMotion(moved, pose[middle, :3, :3], travel, drift)


def _judged(r: Readings, frame: Array) -> Finding | None:
    motion = _slide_motion(r)
    if motion is None or np.std(motion.travel) < 1e-4:
        return None
    raw = frame[:3, :3].T
    rotation, moved = raw @ motion.rotation, motion.moved @ raw.T
    direction, std, left, straight = motion.along(rotation, moved)
    axis = direction / max(float(np.linalg.norm(direction)), 1e-12)
    scale = float(np.linalg.norm(direction))
    clear = left < 1.0 - _CLEAR and scale > _STD * std.max()
    if clear and left < _GOOD and axis[2] > np.cos(max(_TILT, _STD * std.max() / scale)):
        return _scaled(r, scale, float(std.max()))
    if clear and axis[2] < 0.9 and np.max(np.abs(axis)) > 0.97:
        return _turned(r, axis)
    lag_finding = _lag_finding(r, left)
    if lag_finding is not None:
        return lag_finding
    other = _explained(r, motion, rotation, moved, straight)
    if other is not None or not clear:
        return other
    if axis[2] < np.cos(max(2.0 * _TILT, _STD * std.max() / scale)):
        return _tilted(r, axis)
    return _scaled(r, scale, float(std.max())) if axis[2] > 0.9 else None


def _tilted(r: Readings, axis: Array) -> Finding:
    """Finding that a sensor moves at an angle to its axis."""
    angle = np.degrees(np.arccos(np.clip(axis[2], -1.0, 1.0)))
    return Finding(
        "mount",
        f"{r.label!r} slides {angle:.0f}° off its z axis: it probably sits askew, or its rotations "
        f"are in another order; give its [streams.mount], and quaternions as qw, qx, qy, qz.",
        bool(angle > 40.0), (r.label,), "tilt",
    )  # fmt: skip


def _scaled(r: Readings, scale: float, std: float) -> Finding | None:
    """Finding that travel and motion differ in scale; None if they agree."""
    if abs(scale - 1.0) < max(0.25, _STD * std):
        return None
    known = {1e3: "positions are probably in millimetres", 1e2: "positions are probably in "
             "centimetres", 39.37: "positions are probably in inches",
             1e-3: "positions are probably 1,000 times too small"}  # fmt: skip
    cause = next((text for k, text in known.items() if abs(scale / k - 1.0) < 0.2), "")
    check = "length-unit" if cause else "slide"
    cause = cause or f"the slide's travel is probably {1.0 / scale:.3g} times the real one"
    return Finding(
        check,
        f"{r.label!r} moves {scale:.3g} m for each metre of its arclength: {cause}; give metres.",
        bool(abs(np.log(scale)) > np.log(1.5)), (r.label,), cause,
    )  # fmt: skip


def _turned(r: Readings, axis: Array) -> Finding:
    """Finding that a sensor moves along another axis than z, or against it."""
    if axis[2] < -0.9:
        return Finding(
            "slide",
            f"{r.label!r} moves against its z axis while its arclength grows: the slide probably "
            f"runs the other way (or arclength is counted from the tip, or the sensor sits with "
            f"−z along the robot); change the sign of its travel.",
            True, (r.label,), "reversed",
        )  # fmt: skip
    k = int(np.argmax(np.abs(axis)))
    name = ("−" if axis[k] < 0.0 else "") + "xyz"[k]
    return Finding(
        "mount",
        f"{r.label!r} slides along its {name} axis, not along z: it probably reports another "
        f"axis along the robot; give its [streams.mount].",
        True, (r.label,), name,
    )  # fmt: skip


def _lag_finding(r: Readings, left: float) -> Finding | None:
    """Finding that the slide's readings lag or lead the sensor's motion; None if neither."""
    shares = np.full(_LATE.size, np.inf)
    for k, late in enumerate(_LATE):
        other = _slide_motion(r, float(late))
        if other is not None:
            direction, _, share, _ = other.along(other.rotation, other.moved)
            shares[k] = share if 0.6 < direction[2] < 1.6 else np.inf
    best = int(np.argmin(shares))
    if abs(_LATE[best]) < 0.12 or left < 1.6 * shares[best] + 0.01 or shares[best] > 0.6:
        return None
    later = "earlier" if _LATE[best] > 0.0 else "later"
    return Finding(
        "slide",
        f"The arclength of {r.label!r} changes {abs(_LATE[best]):.2g} s {later} than the sensor "
        f"moves ({'earlier' if later == 'later' else 'later'} stamps of one clock): slide and "
        f"tracker probably have different clocks; shift the times of one.",
        False, (r.label,), "late",
    )  # fmt: skip


def _explained(
    r: Readings, motion: _SlideMotion, rotation: Array, moved: Array, left: float
) -> Finding | None:
    """Finding that another interpretation of the columns lets motion follow the slide; or None."""
    pose = se3.pose(rotation, np.zeros(3))
    tries: list[tuple[str, str, Array, Array]] = [
        ("quaternion", "the quaternions are probably [x, y, z, w]; give qw, qx, qy, qz",
         reordered(pose, [3, 0, 1, 2])[:, :3, :3], moved),
        ("quaternion", "the quaternions are probably in a cyclic order; give qw, qx, qy, qz",
         reordered(pose, [1, 2, 3, 0])[:, :3, :3], moved),
        ("quaternion", "the rotations are probably those from world to body; conjugate them",
         np.swapaxes(rotation, -1, -2), moved),
    ]  # fmt: skip
    for matrix, shown in signed_axes():
        text = f"x, y, z are probably {shown} of the rotations' axes; export both alike"
        tries.append(("axes", text, rotation, moved @ matrix.T))
    judged = []
    for check, text, turned, shifted in tries:
        judged.append((motion.along(turned, shifted)[3], check, text))
    share, check, text = min(judged)
    if not share < min(0.4 * left, 0.4):  # also true for NaN
        return None
    return Finding(
        check,
        f"{r.label!r} does not move along its axis while it slides ({left:.0%} of its motion is "
        f"left unexplained, {share:.0%} with one change): {text}.",
        True, (r.label,), text,
    )  # fmt: skip
