"""Checks of the times of readings: units, clocks that jump or do not overlap, repeated rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings

_FEWEST = 8  # least number of readings for a check
_SLOWEST = 3.0  # s, median time between readings beyond which the unit is probably not seconds
_FASTEST = {True: 2.0e3, False: 4.0e4}  # Hz, largest plausible rate of trackers (True) and others
_JUMP = 30.0  # s, shortest step of time that is reported as a jump of a clock
_SAME = 0.1  # largest plausible share of rows with the time and place of the row before
_FROZEN = 12  # rows of one value from a noisy sensor that are reported
_PLACES = 100  # places of one stream that are checked
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def check_sampling(
    sensors: Sequence[Readings], truth: Sequence[Readings] = ()
) -> Iterator[Finding]:
    """Check the times of streams, each alone and against the others.

    Thresholds are physical limits of devices, not statistics; correct recordings stay far from
    them.

    Args:
        sensors: Streams to estimate from.
        truth: Truth streams.

    Yields:
        Findings.
    """
    streams = [r for r in (*sensors, *truth) if len(r) >= _FEWEST]
    slow = [r for r in streams if _typical(r) > _SLOWEST]
    others = [r for r in streams if _typical(r) <= _SLOWEST]
    if slow:
        yield _too_slow(slow)
    for r in streams:
        rate = 1.0 / max(_typical(r), 1e-12)
        if rate > _FASTEST[r.tracker]:
            yield Finding(
                "time-unit",
                f"Stream {r.label!r} has {rate:,.0f} readings a second, more than such a sensor "
                f"gives: its times are probably in minutes or hours, or were divided by a thousand "
                f"too often; give seconds.",
                True, (r.label,), "seconds",
            )  # fmt: skip
        yield from _repeats(r)
        yield from _jumps(r)
    yield from _apart(others)


def _typical(r: Readings) -> float:
    """Median time between distinct time stamps, s."""
    steps = np.diff(np.sort(r.time))
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else 1.0


def _too_slow(slow: Sequence[Readings]) -> Finding:
    step = _typical(slow[0])
    factor = next((k for k in _UNITS if k / step > 1.0), 1e9)
    names = tuple(r.label for r in slow)
    return Finding(
        "time-unit",
        f"Readings of {listed(names)} are {step:,.4g} s apart, over "
        f"{np.ptp(slow[0].time):,.4g} s: the times are probably in {_UNITS[factor]} "
        f"({factor / step:.4g} Hz); give seconds.",
        True, names, _UNITS[factor],
    )  # fmt: skip


def _repeats(r: Readings) -> Iterator[Finding]:
    same = (np.diff(r.time) == 0.0) & (np.diff(r.arclength) == 0.0)
    share = float(np.mean(same))
    if share > _SAME:
        flat = r.values.reshape(len(r), -1)
        alike = float(np.mean(np.all(flat[1:][same] == flat[:-1][same], axis=1)))
        what = (
            "and their values: rows stand there twice, probably by copying, and would count as "
            "information twice; delete the copies"
            if alike > 0.5
            else "but other values: stamps are probably rounded; export all their digits"
        )
        yield Finding(
            "sampling",
            f"{share:.0%} of the rows of {r.label!r} have time and place of the row before {what}.",
            alike > 0.5, (r.label,), "repeats" if alike > 0.5 else "stamps",
        )  # fmt: skip
        return
    if r.tracker:
        for body in _bodies(r):
            yield from _frozen(body)


def _bodies(r: Readings) -> list[Readings]:
    """The stream, or its readings at each place if it reads several places at once."""
    if not np.any(np.diff(r.time) == 0.0):
        return [r]
    return [r.select(r.arclength == place) for place in np.unique(r.arclength)[:_PLACES]]


def _frozen(r: Readings) -> Iterator[Finding]:
    """Yield a finding if a body's readings, otherwise noisy, repeat one value for long."""
    changed = np.any(np.diff(r.values.reshape(len(r), -1), axis=0) != 0.0, axis=1)
    if not changed.size or np.mean(changed) < 0.5:
        return
    edges = np.flatnonzero(np.append(changed, True))
    starts = np.append(0, edges[:-1] + 1)
    frozen = r.time[edges] - r.time[starts]
    at = int(np.argmax(frozen))
    if edges[at] - starts[at] >= _FROZEN:
        yield Finding(
            "sampling",
            f"{r.label!r} repeats one value from {r.time[starts[at]]:.4g} s on for "
            f"{frozen[at]:.3g} s, although it is noisy elsewhere: its last value was probably "
            f"kept while it saw nothing; delete those rows.",
            False, (r.label,), "frozen",
        )  # fmt: skip


def _jumps(r: Readings) -> Iterator[Finding]:
    steps = np.diff(r.time)
    longest = float(steps.max())
    rest = float(np.ptp(r.time)) - longest
    if longest > max(_JUMP, 1e3 * _typical(r), 3.0 * rest):
        at = int(np.argmax(steps))
        yield Finding(
            "clock",
            f"The clock of {r.label!r} jumps by {longest:,.4g} s after row {at}, at "
            f"{r.time[at]:,.6g} s: two clocks are probably mixed; correct the later times.",
            True, (r.label,), "jump",
        )  # fmt: skip


def _apart(streams: Sequence[Readings]) -> Iterator[Finding]:
    """Yield findings on streams whose times do not overlap most others', or are far shorter.

    The sensors are the first of the streams.
    """
    spans = np.array([[r.time.min(), r.time.max()] for r in streams]).reshape(-1, 2)
    if len(spans) < 2:
        return
    meets = np.array([[_overlap(a, b) > 0.05 for b in spans] for a in spans])
    groups = sorted({tuple(np.flatnonzero(row).tolist()) for row in meets})
    main, first = set(sorted(groups, key=len)[-1]), groups[0]
    main = set(first) if len(first) >= 2 and 2 * len(first) >= len(main) else main
    off = [j for j in range(len(streams)) if j not in main]
    if off:
        names = tuple(streams[j].label for j in off)
        start, end = spans[off[0]]
        others = spans[sorted(main)]
        yield Finding(
            "clock",
            f"{listed(names)} runs from {start:,.6g} to {end:,.6g} s, the other streams from "
            f"{others[:, 0].min():,.6g} to {others[:, 1].max():,.6g} s: the clocks have probably "
            f"different zeros; subtract the difference of {start - others[:, 0].min():,.6g} s.",
            True, names, "zero",
        )  # fmt: skip
    middle = np.median(np.ptp(spans, axis=1))
    for r, span in zip(streams, spans, strict=True):
        if np.ptp(span) < 0.02 * middle and len(r) > 100:
            yield Finding(
                "time-unit",
                f"{r.label!r} has {len(r)} readings within {np.ptp(span):.3g} s, the others last "
                f"{middle:.3g} s: its times are probably not in seconds; give seconds.",
                True, (r.label,), "seconds",
            )  # fmt: skip


def _overlap(a: Array, b: Array) -> float:
    """Overlap of two time spans over the shorter one."""
    common = min(a[1], b[1]) - max(a[0], b[0])
    return float(np.clip(common / max(min(np.ptp(a), np.ptp(b)), 1e-12), 0.0, 1.0))
