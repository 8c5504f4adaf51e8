"""Check for positions out of the robot's reach, or too near its base.

Positions too near the base, and tiny arclengths, are probably in metres, but read as millimetres.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.plausibility.session import Streams, as_poses, weights
from glissando.evaluation.plausibility.shape import largest_extension
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.robot import Robot, base_std
from glissando.model.sensors.readings import Readings

_SLACK = 0.15  # tolerance of the reach over the robot's length
_FAR = 20.0  # distance from the base over the robot's length, beyond which the unit is wrong
_FEW = 0.2  # largest share of false readings in a stream; more indicate a wrong unit or frame
_NEAR = 0.02  # least plausible distance from the base over the arclength, except for a closed loop
_AWAY = 0.1  # least arclength over the robot's length for the previous check
_TINY = 1e-6, 1.01e-3  # arclengths over the robot's length that indicate metres read as mm


def check_reach(streams: Streams) -> Iterator[Finding]:
    """Check for single readings out of reach; the finding names the farthest row.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    for r in streams.tracked:
        beyond = np.flatnonzero(out_of_reach(streams.robot, r))
        if beyond.size:
            distance = distance_from_base(streams.robot, r)
            row = int(beyond[np.argmax(distance[beyond])])
            more = f" (and {beyond.size - 1} more rows)" * (beyond.size > 1)
            yield Finding(
                "reach",
                f"Row {row} of {r.label!r}, at {r.time[row]:.4g} s, lies {distance[row]:.4g} m "
                f"from the base at arclength {r.arclength[row]:.3g} m{more}, out of the robot's "
                f"reach: probably a false reading, which an estimate leaves out; delete it.",
                False, (r.label,), "row",
            )  # fmt: skip


def check_far(streams: Streams) -> Iterator[Finding]:
    """Check for streams many times the robot's length away from its known base.

    Args:
        streams: Streams of a session.

    Yields:
        Refusals.
    """
    robot = streams.robot
    if not robot.prior.fixes_base:
        return
    framed = {s for p in robot.sensor_parameters if p.kind == "frame" for s in p.streams}
    for r in streams.tracked:
        if r.name in framed or weights(r)[0] == 0.0:
            continue
        far = float(np.median(distance_from_base(robot, r)))
        if far > _FAR * robot.length:
            yield Finding(
                "reach",
                f"Positions of {r.label!r} lie {far:.3g} m from the base of a robot of "
                f"{robot.length:.3g} m: most likely they are in millimetres, or in a tracker's "
                f'frame; give metres, or length_unit = "mm", and state the frame.',
                True, (r.label,), "unit",
            )  # fmt: skip


def out_of_reach(robot: Robot, r: Readings) -> NDArray[np.bool_]:
    """Mask (M,) of a tracker's readings out of the robot's reach.

    All false if too many are out of reach, which indicates a wrong unit or frame, or if the base
    is free.

    Args:
        robot: The robot.
        r: Readings corrected by sensor parameters.
    """
    none = np.zeros(len(r), dtype=bool)
    if not len(r) or not r.tracker or weights(r)[0] == 0.0 or not robot.prior.fixes_base:
        return none
    slack = max(_SLACK * robot.length, 3.0 * base_std(robot.prior, robot.time_rate))
    for p in robot.sensor_parameters:
        if p.kind == "frame" and r.name in p.streams:
            slack += 3.0 * float(np.linalg.norm(p.std[:3]) + robot.length * p.std[3:].max())
    reach = r.arclength * (1.0 + 3.0 * largest_extension(robot)) + slack
    beyond = ~(distance_from_base(robot, r) <= reach)
    return beyond if beyond.mean() <= _FEW else none


def distance_from_base(robot: Robot, r: Readings) -> Array:
    """Distances (M,) of a tracker's cross-sections from the expected base of the robot, m."""
    base = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0])).pose[0, 0, :3, 3]
    return np.linalg.norm(as_poses(r)[:, :3, 3] - base, axis=1)


def check_size(streams: Streams) -> Iterator[Finding]:
    """Check for trackers whose positions stay at the base, or whose arclengths are tiny.

    Args:
        streams: Streams of a session.

    Yields:
        Findings; those on arclengths alone are warnings.
    """
    robot = streams.robot
    low, high = (share * robot.length for share in _TINY)
    looped = [r for r in streams.tracked if _at_base(robot, r)]
    tiny = [r for r in streams.tracked if low < r.arclength.max() < high]
    for suspects, refusal in ((looped, True), (tiny, False)):
        if not suspects:
            continue
        names = tuple(r.label for r in suspects)
        farthest = max(suspects, key=lambda r: r.arclength.max())
        place, seen = farthest.arclength.max(), f"a robot of {robot.length:.3g} m"
        if refusal:
            near = distance_from_base(robot, farthest).max()
            seen = f"never more than {near:.2g} m from the base of {seen}, as if that were a loop"
        yield Finding(
            "length-unit",
            f"{listed(names)} sit{'s' * (len(suspects) == 1)} at arclengths up to {place:.2g} m, "
            f"{'' if refusal else 'on '}{seen}: lengths are probably in metres, read as "
            f"millimetres; give metres, or leave out length_unit.",
            refusal, names, "metres, read as millimetres",
        )  # fmt: skip


def _at_base(robot: Robot, r: Readings) -> bool:
    """Whether a tracker along the robot always stays at the known base."""
    away = r.arclength > _AWAY * robot.length
    moved = any(p.kind == "frame" and r.name in p.streams for p in robot.sensor_parameters)
    if moved or not robot.prior.fixes_base or weights(r)[0] == 0.0 or not away.any():
        return False
    near = distance_from_base(robot, r) < _NEAR * r.arclength
    return bool(np.all(near[away]))
