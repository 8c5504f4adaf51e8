"""The guard: all plausibility checks of a session, before and after the estimate."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from glissando.estimation.posterior import Posterior
from glissando.estimation.reading_fit import fit_of
from glissando.evaluation.plausibility.fibre import check_fibres
from glissando.evaluation.plausibility.finding import Finding, require_known
from glissando.evaluation.plausibility.inertial import check_accelerometers, check_gyros
from glissando.evaluation.plausibility.lag import check_lag
from glissando.evaluation.plausibility.noise import check_noise
from glissando.evaluation.plausibility.pace import check_pace
from glissando.evaluation.plausibility.poses import check_poses
from glissando.evaluation.plausibility.reach import check_far, check_reach, check_size, out_of_reach
from glissando.evaluation.plausibility.sampling import check_sampling
from glissando.evaluation.plausibility.session import Streams
from glissando.evaluation.plausibility.slide import check_slide
from glissando.evaluation.plausibility.span import check_span
from glissando.evaluation.plausibility.speed import check_grid, check_speed
from glissando.geometry.se3 import Array
from glissando.io.recording import Recording
from glissando.model.evenly import evenly_chosen
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings

_ROWS = 60  # readings of a stream with which an estimate is compared
_FOLLOWED = 5.0  # largest plausible median residual, in standard deviations
_INTERVALS = 40  # time intervals at whose midpoints the standard deviation is checked
_SWOLLEN, _FLAT = 1.5, 1.25  # ratio of std between and at time nodes: too large; target


def examine(
    robot: Robot,
    readings: Sequence[Readings],
    truth: Sequence[Readings] = (),
    *,
    frames: Mapping[str, Array] | None = None,
    window: tuple[float, float] | None = None,
    allow: Collection[str] = (),
) -> list[Finding]:
    """Check the plausibility of readings, from the data alone.

    Args:
        robot: The robot of the readings; its sensor parameters are applied to `readings`.
        readings: Streams to estimate from.
        truth: Truth streams, to which no sensor parameters are applied.
        frames: Poses T_wf (4, 4) of the frames of streams in the world, by stream name.
        window: First and last time to estimate, s; None to skip the check of the time grid.
        allow: Names of checks to skip.

    Raises:
        GlissandoError: A name in `allow` is not that of a check.
    """
    require_known(allow)
    corrected_readings = [corrected(r, robot.sensor_parameters) for r in readings]
    streams = Streams(
        robot,
        tuple(r for r in corrected_readings if len(r)),
        tuple(t for t in truth if len(t)),
        frames or {},
    )
    with np.errstate(all="ignore"):  # implausible numbers may overflow
        try:
            findings = _examined(streams, window)
        except np.linalg.LinAlgError:
            text = (
                "Some readings are beyond what can be computed: probably in another unit or frame"
            )
            findings = [Finding("shape", f"{text}; look at their numbers.", True)]
    return [finding for finding in findings if finding.name not in allow]


def _examined(streams: Streams, window: tuple[float, float] | None) -> list[Finding]:
    """All findings on a session."""
    findings = [
        *check_sampling(streams.sensors, streams.truth),
        *check_noise(streams.sensors, streams.robot.length),
        *check_reach(streams),
        *check_accelerometers(streams),
    ]
    if window is not None and streams.sensors:
        findings += check_grid(streams, window)
    if not any(f.refusal and f.name in ("time-unit", "clock", "grid") for f in findings):
        findings += _on_motion(streams)
    if not any(f.refusal for f in findings):
        findings += [*check_far(streams), *check_pace(streams), *check_fibres(streams)]
    return _without_echoes(findings)


def _on_motion(streams: Streams) -> list[Finding]:
    """Findings that rely on the times of readings: speeds, slides, rotations, lags and shapes."""
    own = [*check_slide(streams), *check_gyros(streams)]
    lags = list(check_lag(streams))
    small = list(check_size(streams))
    poses = [f for f in small if f.refusal]
    if not lags and not poses:
        poses = list(check_poses(streams)) or list(check_span(streams))
    slid = {name for f in own for name in f.streams if f.name != "gyro"}
    other = [f for f in poses if f.name not in ("shape", "base")]
    if slid and not other:  # the mistake of a slide explains the misfit of shapes
        poses = []
    poses += [f for f in small if not f.refusal]
    same = {(f.name, f.streams) for f in poses}
    own = [f for f in own if (f.name, f.streams) not in same]
    return [*([] if own or poses else check_speed(streams)), *own, *lags, *poses]


def _without_echoes(findings: Sequence[Finding]) -> list[Finding]:
    """Findings without those on the noise of streams in a wrong unit, which explains the noise."""
    scaled = {
        name
        for f in findings
        if f.name in ("length-unit", "time-unit", "gyro", "speed")
        for name in f.streams
    }
    return [f for f in findings if f.name != "noise" or not scaled & {*f.streams}]


def examine_recording(
    recording: Recording,
    robot: Robot,
    readings: Sequence[Readings],
    truth: Sequence[Readings],
    window: tuple[float, float],
    allow: Collection[str] = (),
) -> list[Finding]:
    """Check the plausibility of the streams of a recording to be estimated.

    Args:
        recording: The recording, with its frames and the checks that it skips.
        robot: The robot.
        readings: Streams to estimate from, inside the window.
        truth: Truth streams, corrected by sensor parameters.
        window: First and last time to estimate, s.
        allow: Names of further checks to skip.

    Raises:
        GlissandoError: A name is not that of a check.
    """
    switched_off = {*recording.allow, *allow}
    frames = recording.frames
    return examine(robot, readings, truth, frames=frames, window=window, allow=switched_off)


def without_false_readings(
    robot: Robot,
    readings: Sequence[Readings],
    dropped: dict[str, dict[str, int]],
    allow: Collection[str] = (),
) -> list[Readings]:
    """Remove readings out of the robot's reach, and count them.

    Args:
        robot: The robot.
        readings: Streams to estimate from.
        dropped: Numbers of rows not used, by stream and reason; updated in place.
        allow: Names of checks to skip; with "reach" no reading is removed.
    """
    if "reach" in allow:
        return list(readings)
    out = []
    for r in readings:
        false = out_of_reach(robot, corrected(r, robot.sensor_parameters))
        if false.any():
            dropped[r.name] = {**dropped.get(r.name, {}), "out of reach": int(false.sum())}
        out.append(r.select(~false))
    return out


def after_estimate(
    posterior: Posterior,
    readings: Sequence[Readings],
    sensor_parameters: Sequence[SensorParameter] = (),
) -> list[Finding]:
    """Check the plausibility of an estimate: streams with large residuals, a coarse time grid.

    Args:
        posterior: The estimate.
        readings: Streams used by the estimate.
        sensor_parameters: Sensor parameters of the robot; the known ones are applied.
    """
    known = [parameter for parameter in sensor_parameters if parameter.known]
    findings = []
    for r in (corrected(r, known) for r in readings):
        r = r.select(evenly_chosen(len(r), _ROWS))
        r = r.inside(posterior.grid)
        if not len(r):
            continue
        squared = fit_of(posterior, r).squared(False, 1.0)
        size = float(np.sqrt(np.median(squared / r.row_count)))
        if size > _FOLLOWED:
            findings.append(
                Finding(
                    "fit",
                    f"The estimate misses {r.label!r} by {size:.3g} of its standard deviations "
                    f"half of the time: readings contradict each other, or their noise is "
                    f"stated far too small; look at glissando check.",
                    False,
                    (r.label,),
                )
            )
    return [*findings, *_coarse_grid(posterior)]


def _coarse_grid(posterior: Posterior) -> Iterator[Finding]:
    """Yield a finding if the standard deviation is much larger between time nodes than at them.

    The variance between nodes grows with the cube of the time step, which gives a sufficient rate.
    """
    nodes, arclength = posterior.grid.time, posterior.grid.arclength[1:]
    if nodes.size < 2 or not arclength.size:
        return
    first = evenly_chosen(nodes.size - 1, _INTERVALS)
    middle = 0.5 * (nodes[first] + nodes[first + 1])
    between, before, after = (
        posterior.at(arclength, time[:, None]).std_position
        for time in (middle, nodes[first], nodes[first + 1])
    )
    share = between / np.maximum(before, after)
    worst = share.max(axis=1)  # at the arclength of the largest ratio, maybe of a sliding sensor
    k = int(np.argsort(worst)[worst.size // 2])
    n, ratio = int(np.argmax(share[k])), float(worst[k])
    if ratio <= _SWOLLEN:
        return
    rate = (nodes.size - 1) / float(nodes[-1] - nodes[0])
    new_rate = rate * ((ratio**2 - 1.0) / (_FLAT**2 - 1.0)) ** (1.0 / 3.0)
    yield Finding(
        "grid",
        f"Confidence swells between time nodes: at {1e3 * arclength[n]:.4g} mm the standard "
        f"deviation of position is {1e3 * max(before[k, n], after[k, n]):.3g} mm at a node and "
        f"{1e3 * between[k, n]:.3g} mm half a step later, at {middle[k]:.4g} s. The nodes are too "
        f"far apart for this prior; set time_rate = {float(f'{new_rate:.2g}'):g} in [grid] (here "
        f"are {rate:.3g} a second).",
        False,
    )
