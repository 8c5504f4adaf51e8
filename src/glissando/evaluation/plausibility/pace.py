"""Check for a robot so slow that its prior's time scale discards information of sliding sensors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando.evaluation.plausibility.finding import Finding
from glissando.evaluation.plausibility.session import Streams, as_poses, weights
from glissando.model.evenly import evenly_chosen
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.separable import SeparablePrior
from glissando.model.sensors.readings import Readings

_FORGOTTEN = 4.0  # time scales after which a reading has no influence under the prior
_SAME = 0.01  # distance along the body over its length, below which readings are at one place
_STILL = 0.01  # displacement over the length, below which a place is at rest
_TRAVERSE = 0.25  # least range of a sliding sensor over the length
_MOST = 0.95  # share of the places read again that must be at rest
_ROWS, _FEW = 500, 20  # readings of a stream that are used; least number of returns
_A_SCALE = 15.0  # time nodes per time scale


def check_pace(streams: Streams) -> Iterator[Finding]:
    """Check sliding sensors for a robot that is much slower than its prior assumes.

    Args:
        streams: Streams of a session.

    Yields:
        Findings, which are warnings.
    """
    prior = streams.robot.prior
    if not isinstance(prior, SeparablePrior | MechanicalPrior):
        return
    for r in streams.sensors:
        if not r.tracker or weights(r)[0] == 0.0 or weights(r)[3] == 0.0:
            continue
        found = _returns(r, _FORGOTTEN * prior.time_scale, streams.robot.length)
        if found is None:
            continue
        moved, later = found
        scale = float(f"{later:.2g}")
        yield Finding(
            "pace",
            f"{r.label!r} finds places where it read them up to {later:.3g} s before, to "
            f"{1e3 * moved:.2g} mm, but the prior forgets within its time_scale of "
            f"{prior.time_scale:g} s what was read elsewhere; for a robot this slow give "
            f"time_scale = {scale:g} in [prior] and time_rate = {_A_SCALE / scale:.2g} in [grid].",
            False, (r.label,),
        )  # fmt: skip


def _returns(r: Readings, after: float, length: float) -> tuple[float, float] | None:
    """95 % quantile of the displacement, m, of places read again, and the longest time between, s.

    None unless the sensor slides, returns to places after more than `after` s, and finds them at
    rest.
    """
    rows = evenly_chosen(len(r), _ROWS)
    time, place, pose = r.time[rows], r.arclength[rows], as_poses(r)[rows]
    apart = np.abs(place[:, None] - place)
    apart[np.abs(time[:, None] - time) < after] = np.inf
    same = apart.argmin(axis=1)
    again = np.flatnonzero(apart[np.arange(rows.size), same] < _SAME * length)
    if again.size < max(_FEW, 0.5 * rows.size) or np.ptp(place[again]) < _TRAVERSE * length:
        return None
    same = same[again]
    along = pose[again, :3, 2] * (place[same] - place[again])[:, None]
    moved = np.linalg.norm(pose[same, :3, 3] - pose[again, :3, 3] - along, axis=1)
    far = float(np.quantile(moved, _MOST))
    return (far, float(np.abs(time[same] - time[again]).max())) if far < _STILL * length else None
