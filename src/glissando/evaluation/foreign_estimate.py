"""Somebody else's estimate of a robot's shape, judged as our own are."""

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

_SAME = 1e-4  # m: samples no farther apart along the body are of one place
_FAR_APART = 0.3  # of the body: between trajectories that far apart nothing is stated
_GAP = 5.0  # usual steps, beyond which nothing is interpolated
_UNITS = "length-unit", "time-unit", "clock"  # checks whose refusals an estimate heeds
_LOOKED_AT = 8  # trajectories whose units are checked
_POINT = ["time", "arclength", "x", "y", "z"]
_TURN, _COV = QUERY_COLUMNS[5:9], QUERY_COLUMNS[-36:]


@dataclass(frozen=True)
class ForeignEstimate(ShortRepr):
    """Trajectories at some arclengths, between which poses are interpolated.

    Attributes:
        arclength: Increasing arclengths (K,), m.
        time: Increasing times of each, s.
        pose: Poses in the world of each (M, 4, 4).
        cov: Covariances of each (M, 6, 6) in the body frame, NaN where there are none.
        turns: Whether rotations are known; positions alone have identity rotations.
    """

    arclength: Array
    time: Sequence[Array]
    pose: Sequence[Array]
    cov: Sequence[Array]
    turns: bool

    @property
    def window(self) -> tuple[float, float]:
        """First and last time that all trajectories cover, s."""
        return max(float(t[0]) for t in self.time), min(float(t[-1]) for t in self.time)

    def covers(self, arclength: Array, time: Array) -> NDArray[np.bool_]:
        """Which points (M,) lie within the arclengths and times of the estimate."""
        first, last = self.window
        low, high = self.arclength[0] - _SAME, self.arclength[-1] + _SAME
        inside = (time >= first) & (time <= last) & (arclength >= low) & (arclength <= high)
        return np.asarray(inside)

    def in_gap(self, arclength: Array, time: Array) -> NDArray[np.bool_]:
        """Which points (M,) lie where a trajectory beside them pauses for many of its steps.

        Or where the next ones are far apart along the body, whose shape between is not stated.
        """
        gaps, rows = np.stack([_in_gap(t, time) for t in self.time]), np.arange(time.size)
        lower, upper = self._neighbours(arclength)
        apart = self.arclength[upper] - self.arclength[lower]
        far = apart > _FAR_APART * float(np.max(self.arclength))
        return np.asarray(gaps[lower, rows] | gaps[upper, rows] | far)

    def _neighbours(self, place: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Numbers (M,) of the trajectories below and above arclengths (M,), one at its own."""
        upper = np.clip(np.searchsorted(self.arclength, place - _SAME), 0, len(self.arclength) - 1)
        return np.maximum(upper - (place < self.arclength[upper] - _SAME), 0), upper

    def dropped(self, truth: Readings) -> dict[str, int]:
        """Number of samples of a truth stream that cannot be judged, by reason."""
        at = truth.arclength, truth.time
        inside = self.covers(*at)
        lost = {
            "outside the estimate": int(np.sum(~inside)),
            "in gaps of the estimate": int(np.sum(inside & self.in_gap(*at))),
        }
        return {reason: count for reason, count in lost.items() if count}

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """Pose and covariance at points (M,), linear in time and on arcs along the body.

        Without rotations it is linear along the body, too. The rest is zero.
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
        part = _on_arc if self.turns else _part
        return StateEstimate(part(near, far, share), zeros, zeros, whole)

    def errors(self, truth: Readings) -> Errors:
        """Errors at the samples of a truth stream that the estimate covers, outside of its gaps."""
        at = truth.arclength, truth.time
        truth = truth.select(self.covers(*at) & ~self.in_gap(*at))
        if self.turns:
            return errors_against(self, truth)
        errors = errors_against(self, _of_backbone(truth))
        none = np.full(len(truth), np.nan)
        return replace(errors, rotation=none, nees_rotation=none)


def _of_backbone(truth: Readings) -> Readings:
    """Truth as positions of the backbone, for an estimate of positions alone.

    Raises:
        SensorError: A sensor is mounted beside the backbone, on a side that it does not state.
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
    """An estimate from delimited text with the columns time,arclength,x,y,z in SI units.

    Rotations qw,qx,qy,qz and covariances c_0_0 … c_5_5 of [linear, angular] in the body frame may
    follow, as `estimate --query` writes them.

    Raises:
        GlissandoError: A column is missing, or a row is wrong.
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
    """An estimate of trajectories, each at an arclength.

    Args:
        tracks: Trajectories of poses or of positions, by name.
        arclength: Arclength of each that counts, m.

    Raises:
        GlissandoError: There is none, a name is no track's, or a track has no positions.
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
    """A report of an estimate's errors, as `glissando report` compares them.

    Raises:
        GlissandoError: No sample of the truth lies within the estimate.
        ImplausibleError: Its lengths or times are not in metres and seconds.
    """
    _require_units(estimate, recording, robot, truth)
    errors = [e for e in (estimate.errors(t) for t in truth) if e.arclength.size]
    if not errors:
        raise GlissandoError(
            f"No truth of {recording.name} lies within the estimate's arclengths and times; name "
            f"streams with --truth, or check units and clock."
        )
    sure = all(np.all(np.isfinite(e.nees_position)) for e in errors)
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
        "consistency": [c.as_json() for c in check(errors)] if sure else [],
    }


def _require_units(
    estimate: ForeignEstimate, recording: Recording, robot: Robot, truth: Sequence[Readings]
) -> None:
    """Raise ImplausibleError for lengths and times that the guard of an estimate would refuse."""
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
    """Which times (M,) lie inside a step that is much longer than a trajectory's usual ones."""
    if time.size < 3:
        return np.zeros(when.size, dtype=bool)
    steps = np.diff(time)
    usual = float(np.median(steps))
    k = np.clip(np.searchsorted(time, when) - 1, 0, time.size - 2)
    away = np.minimum(when - time[k], time[k + 1] - when)
    return np.asarray((steps[k] > _GAP * usual) & (away > 0.5 * usual))


def _between(time: Array, pose: Array, cov: Array, when: Array) -> tuple[Array, Array]:
    """Poses (M, 4, 4) and covariances (M, 6, 6) of one trajectory at times (M,)."""
    if time.size == 1:
        return np.repeat(pose, when.size, 0), np.repeat(cov, when.size, 0)
    k = np.clip(np.searchsorted(time, when) - 1, 0, time.size - 2)
    share = np.clip((when - time[k]) / (time[k + 1] - time[k]), 0.0, 1.0)
    part = share[:, None, None]
    return _part(pose[k], pose[k + 1], share), (1.0 - part) * cov[k] + part * cov[k + 1]


def _on_arc(near: Array, far: Array, share: Array) -> Array:
    """Poses (M, 4, 4) a share of the way along an arc that leads from one to the other."""
    twist = se3.log(se3.inverse(near) @ far)
    return np.asarray(near @ se3.exp(share[:, None] * twist))


def _part(near: Array, far: Array, share: Array) -> Array:
    """Poses (M, 4, 4) a share of the way, in a straight line with a steady turn."""
    position = near[:, :3, 3] + share[:, None] * (far[:, :3, 3] - near[:, :3, 3])
    turn = se3.so3_log(np.swapaxes(near[:, :3, :3], 1, 2) @ far[:, :3, :3])
    return se3.pose(near[:, :3, :3] @ se3.so3_exp(share[:, None] * turn), position)
