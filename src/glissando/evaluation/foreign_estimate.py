"""Estimates of a robot's shape by other software, evaluated like those of this package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando.errors import GlissandoError, ImplausibleError, SensorError
from glissando.estimation.state_estimate import StateEstimate
from glissando.evaluation.consistency import check
from glissando.evaluation.metrics import Errors, errors_against, pool
from glissando.evaluation.plausibility.examine import examine
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.foreign.delimited import cells_of, samples
from glissando.io.foreign.tracks import Track, unit_rotations
from glissando.io.query_csv import QUERY_COLUMNS
from glissando.io.recording import Recording
from glissando.model.evenly import evenly_chosen
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    CoilReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
)
from glissando.model.short_repr import ShortRepr

_SAME = 1e-4  # m, distance along the body up to which samples are of one place
_FAR_APART = 0.3  # share of the body, beyond which trajectories are not interpolated between
_GAP = 5.0  # median time steps, beyond which there is no interpolation in time
_UNITS = "length-unit", "time-unit", "clock"  # checks whose refusals apply to an estimate
_LOOKED_AT = 8  # trajectories whose units are checked
_POINT = ["time", "arclength", "x", "y", "z"]
_TURN, _COV = QUERY_COLUMNS[5:9], QUERY_COLUMNS[-36:]


@dataclass(frozen=True)
class ForeignEstimate(ShortRepr):
    """Trajectories at K arclengths, between which poses are interpolated.

    Attributes:
        arclength: Increasing arclengths (K,), m.
        time: Increasing times (M,) of each trajectory, s.
        pose: Poses (M, 4, 4) of each trajectory in the world.
        cov: Covariances (M, 6, 6) of each trajectory in the body frame; NaN if unknown.
        turns: Whether rotations are known; otherwise they are identity.
    """

    arclength: Array
    time: Sequence[Array]
    pose: Sequence[Array]
    cov: Sequence[Array]
    turns: bool

    @property
    def window(self) -> tuple[float, float]:
        """First and last time covered by all trajectories, s."""
        return max(float(t[0]) for t in self.time), min(float(t[-1]) for t in self.time)

    def covers(self, arclength: Array, time: Array) -> NDArray[np.bool_]:
        """Mask (M,) of the points within the arclengths and times of the estimate."""
        first, last = self.window
        low, high = self.arclength[0] - _SAME, self.arclength[-1] + _SAME
        inside = (time >= first) & (time <= last) & (arclength >= low) & (arclength <= high)
        return np.asarray(inside)

    def in_gap(self, arclength: Array, time: Array) -> NDArray[np.bool_]:
        """Mask (M,) of the points in a gap of the estimate, where poses are not interpolated.

        Either a neighbouring trajectory pauses for many of its time steps, or the two neighbouring
        trajectories are far apart along the body.
        """
        gaps, rows = np.stack([_in_gap(t, time) for t in self.time]), np.arange(time.size)
        lower, upper = self._neighbours(arclength)
        apart = self.arclength[upper] - self.arclength[lower]
        far = apart > _FAR_APART * float(np.max(self.arclength))
        return np.asarray(gaps[lower, rows] | gaps[upper, rows] | far)

    def _neighbours(self, place: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Indices (M,) of the trajectories below and above arclengths (M,); equal at one's own."""
        upper = np.clip(np.searchsorted(self.arclength, place - _SAME), 0, len(self.arclength) - 1)
        return np.maximum(upper - (place < self.arclength[upper] - _SAME), 0), upper

    def dropped(self, truth: Readings) -> dict[str, int]:
        """Number of samples of a truth stream that cannot be compared, by reason."""
        at = truth.arclength, truth.time
        inside = self.covers(*at)
        lost = {
            "outside the estimate": int(np.sum(~inside)),
            "in gaps of the estimate": int(np.sum(inside & self.in_gap(*at))),
        }
        return {reason: count for reason, count in lost.items() if count}

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """Poses and covariances at points (M,), linear in time and on arcs along the body.

        Without rotations the interpolation is linear in arclength, too. Strain, velocity and their
        covariances are zero.
        """
        place, when = np.asarray(arclength, dtype=float), np.asarray(time, dtype=float)
        lower, upper = self._neighbours(place)
        gap = self.arclength[upper] - self.arclength[lower]
        share = np.where(gap > 0.0, (place - self.arclength[lower]) / np.where(gap, gap, 1.0), 0.0)
        each = [
            _between(t, p, c, when) for t, p, c in zip(self.time, self.pose, self.cov, strict=True)
        ]
        pose, cov = (np.stack([e[i] for e in each]) for i in range(2))
        rows = np.arange(place.size)
        near, far = pose[lower, rows], pose[upper, rows]
        whole = np.zeros((place.size, 18, 18))
        whole[:, :6, :6] = (1.0 - share)[:, None, None] * cov[lower, rows]
        whole[:, :6, :6] += share[:, None, None] * cov[upper, rows]
        zeros = np.zeros((place.size, 6))
        interpolated = _on_arc if self.turns else _on_line
        return StateEstimate(interpolated(near, far, share), zeros, zeros, whole)

    def errors(self, truth: Readings) -> Errors:
        """Errors at the samples of a truth stream that the estimate covers, outside its gaps."""
        at = truth.arclength, truth.time
        truth = truth.select(self.covers(*at) & ~self.in_gap(*at))
        if self.turns:
            return errors_against(self, truth)
        errors = errors_against(self, _of_backbone(truth))
        none = np.full(len(truth), np.nan)
        return replace(errors, rotation=none, nees_rotation=none)


def _of_backbone(truth: Readings) -> Readings:
    """Convert truth to positions of the backbone, for an estimate of positions alone.

    Raises:
        SensorError: A sensor is mounted beside the backbone, and its rotation is not known.
    """
    if isinstance(truth, PoseReadings):
        lever = se3.adjoint(truth.mount)
        pose = truth.values @ se3.inverse(truth.mount)
        cov = se3.position_covariance(lever @ truth.cov @ np.swapaxes(lever, -1, -2))
    elif isinstance(truth, OrientationReadings):
        return truth
    elif np.any(truth.mount[..., :3, 3]):
        raise SensorError(
            f"{truth.label} sits beside the backbone, and an estimate of positions alone does not "
            f"say on which side; give rotations (qw, qx, qy, qz) or other truth."
        )
    elif isinstance(truth, CoilReadings):
        pose, cov = truth.values, truth.cov[..., :3, :3]
    else:
        return truth
    turn = pose[:, :3, :3]
    return PositionReadings(
        time=truth.time,
        arclength=truth.arclength,
        values=pose[:, :3, 3],
        cov=turn @ cov @ np.swapaxes(turn, -1, -2),
        name=truth.name,
    )


def read_estimate(path: Path) -> ForeignEstimate:
    """Read an estimate from delimited text with the columns time,arclength,x,y,z in SI units.

    Rotations qw,qx,qy,qz and covariances c_0_0 … c_5_5 of [linear, angular] in the body frame are
    optional, as `estimate --query` writes them.

    Raises:
        GlissandoError: A column is missing, a row is invalid, or there are no rows.
    """
    lines = [(number, cells) for number, cells in cells_of(path) if any(cells)]
    titles = lines[0][1] if lines else []
    missing = [name for name in _POINT if name not in titles]
    if missing:
        raise GlissandoError(
            f"{path.name} line 1: an estimate needs the columns {','.join(_POINT)}; "
            f"{', '.join(missing)} is missing. Or give trajectories, with --arclength of each."
        )
    turns = set(_TURN) <= set(titles)
    spread_too = turns and set(_COV) <= set(titles)
    names = [*_POINT, *(_TURN if turns else []), *(_COV if spread_too else [])]
    numbered = [(number, [str(k), *cells]) for k, (number, cells) in enumerate(lines[1:])]
    at = [1 + titles.index(name) for name in names]
    table = samples(path, numbered, 0, at, 1.0, zeros=True).values
    tracks = {}
    for place in np.unique(np.round(table[:, 1] / _SAME)) * _SAME:
        rows = table[np.abs(table[:, 1] - place) < _SAME]
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        rows = rows[np.append(True, np.diff(rows[:, 0]) > 0.0)]
        tracks[float(rows[0, 1])] = rows
    if not tracks:
        raise GlissandoError(f"{path.name} holds no rows; an estimate needs some.")
    poses = [np.tile(np.eye(4), (len(rows), 1, 1)) for rows in tracks.values()]
    cov = [np.full((len(rows), 6, 6), np.nan) for rows in tracks.values()]
    for pose, spread, rows in zip(poses, cov, tracks.values(), strict=True):
        pose[:, :3, 3] = rows[:, 2:5]
        if turns:
            pose[:, :3, :3] = unit_rotations(path, rows[:, 5:9])
        if spread_too:
            spread[:] = rows[:, 9:].reshape(-1, 6, 6)
    return ForeignEstimate(
        np.array([*tracks]), [r[:, 0] for r in tracks.values()], poses, cov, turns
    )


def estimate_of_tracks(tracks: Sequence[Track], arclength: Mapping[str, float]) -> ForeignEstimate:
    """Create an estimate from trajectories, each at an arclength.

    Args:
        tracks: Trajectories of poses or positions.
        arclength: Arclengths, m, of the trajectories to use, by name.

    Raises:
        GlissandoError: No trajectory is named, a name is unknown, or a trajectory has no positions.
    """
    names = [t.name for t in tracks]
    for name in arclength:
        if name not in names:
            raise GlissandoError(
                f"The files hold no {name!r}; they hold {', '.join(names)}. Correct the name."
            )
    known = sorted((t for t in tracks if t.name in arclength), key=lambda t: arclength[t.name])
    if not known or any(t.kind not in ("pose", "coil", "position") for t in known):
        raise GlissandoError(
            f"Say where on the robot the trajectories {', '.join(names)} are: "
            f"--arclength NAME=METRES,…"
        )
    turns = all(t.kind != "position" for t in known)
    poses = [np.tile(np.eye(4), (t.time.size, 1, 1)) for t in known]
    for pose, t in zip(poses, known, strict=True):
        pose[:, :3, 3] = t.values if t.kind == "position" else t.values[:, :3, 3]
        pose[:, :3, :3] = t.values[:, :3, :3] if turns else np.eye(3)
    none = [np.full((t.time.size, 6, 6), np.nan) for t in known]
    places = np.array([arclength[t.name] for t in known])
    return ForeignEstimate(places, [t.time for t in known], poses, none, turns)


def foreign_report(
    name: str, estimate: ForeignEstimate, recording: Recording, robot: Robot, truth: list[Readings]
) -> dict[str, Any]:
    """Report of an estimate's errors, in the format that `glissando report` compares.

    Raises:
        GlissandoError: No sample of the truth lies within the estimate.
        ImplausibleError: Lengths or times of the estimate are not in metres and seconds.
    """
    _require_units(estimate, recording, robot, truth)
    errors = [e for e in (estimate.errors(t) for t in truth) if e.arclength.size]
    if not errors:
        raise GlissandoError(
            f"No truth of {recording.name} lies within the estimate's arclengths and times; name "
            f"streams with --truth, or check units and clock."
        )
    has_covariances = all(np.all(np.isfinite(e.nees_position)) for e in errors)
    return {
        "recording": recording.name,
        "robot": robot.name,
        "window": list(estimate.window),
        "status": f"imported from {name}",
        "readings": {},
        "dropped": {t.name: lost for t in truth if (lost := estimate.dropped(t))},
        "calibration": [],
        "overall": pool(errors).summary(),
        "sites": [e.site_summary() for e in errors],
        "consistency": [c.as_json() for c in check(errors)] if has_covariances else [],
    }


def _require_units(
    estimate: ForeignEstimate, recording: Recording, robot: Robot, truth: Sequence[Readings]
) -> None:
    """Raise ImplausibleError if the guard refuses the units of lengths or times."""
    farthest = float(estimate.arclength[-1])
    if farthest > 1.5 * robot.length:
        raise ImplausibleError(
            f"The estimate goes to arclength {farthest:.4g} m, and robot {robot.name!r} is "
            f"{robot.length:.4g} m long: it is probably in another unit; give metres."
        )
    count = len(estimate.time)
    some = evenly_chosen(count, _LOOKED_AT)
    readings = [
        PositionReadings(
            time=estimate.time[k],
            arclength=np.full(estimate.time[k].size, estimate.arclength[k]),
            values=estimate.pose[k][:, :3, 3],
            cov=np.full(3, 1e-6),
            name=f"estimate at {estimate.arclength[k]:.4g} m",
        )
        for k in some
    ]
    findings = examine(robot, readings, truth, allow=recording.allow)
    wrong = [f.sentence for f in findings if f.refusal and f.name in _UNITS]
    if wrong:
        raise ImplausibleError(" ".join(wrong))


def _in_gap(time: Array, when: Array) -> NDArray[np.bool_]:
    """Mask (M,) of the times inside a step much longer than a trajectory's median step."""
    if time.size < 3:
        return np.zeros(when.size, dtype=bool)
    steps = np.diff(time)
    usual = float(np.median(steps))
    k = np.clip(np.searchsorted(time, when) - 1, 0, time.size - 2)
    away = np.minimum(when - time[k], time[k + 1] - when)
    return np.asarray((steps[k] > _GAP * usual) & (away > 0.5 * usual))


def _between(time: Array, pose: Array, cov: Array, when: Array) -> tuple[Array, Array]:
    """Interpolated poses (M, 4, 4) and covariances (M, 6, 6) of one trajectory at times (M,)."""
    if time.size == 1:
        return np.repeat(pose, when.size, 0), np.repeat(cov, when.size, 0)
    k = np.clip(np.searchsorted(time, when) - 1, 0, time.size - 2)
    share = np.clip((when - time[k]) / (time[k + 1] - time[k]), 0.0, 1.0)
    part = share[:, None, None]
    return _on_line(pose[k], pose[k + 1], share), (1.0 - part) * cov[k] + part * cov[k + 1]


def _on_arc(near: Array, far: Array, share: Array) -> Array:
    """Poses (M, 4, 4) at a share of the way along the arc from one pose to the other."""
    twist = se3.log(se3.inverse(near) @ far)
    return np.asarray(near @ se3.exp(share[:, None] * twist))


def _on_line(near: Array, far: Array, share: Array) -> Array:
    """Poses (M, 4, 4) at a share of the way, on a straight line with constant rotation rate."""
    position = near[:, :3, 3] + share[:, None] * (far[:, :3, 3] - near[:, :3, 3])
    turn = se3.so3_log(np.swapaxes(near[:, :3, :3], 1, 2) @ far[:, :3, :3])
    return se3.pose(near[:, :3, :3] @ se3.so3_exp(share[:, None] * turn), position)
