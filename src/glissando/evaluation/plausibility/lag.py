"""Check for streams whose motion is later or earlier than that of the others."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from glissando.evaluation.plausibility.finding import Finding, listed
from glissando.evaluation.plausibility.session import Streams, as_poses, weights
from glissando.geometry.se3 import Array
from glissando.model.sensors.readings import Readings

_RATE = 25.0  # Hz, rate at which speeds are correlated
_SMOOTH = 5  # samples of the moving average
_FARTHEST = 0.3  # largest lag over the common time
_ALIKE = 0.75  # least correlation of two streams' speeds for a lag
_AT_ONCE = 0.9  # correlation without a lag, beyond which motions are simultaneous
_BETTER = 0.12  # least gain of correlation by a lag
_LEAST = 0.15  # s, smallest lag that is reported
_AGREE = 3  # least number of other streams with a known lag, if there are as many
_ALIKE_LAGS, _MOST = 0.15, 0.6  # s, tolerance of consistent lags; least share of consistent lags
_AGAIN = 0.3  # rise of the autocorrelation before a lag, beyond which a motion is repetitive
_TRAVEL = 5e-3  # m, range of arclength beyond which a sensor slides


def check_lag(streams: Streams) -> Iterator[Finding]:
    """Check clocks by cross-correlation of the speeds of bodies and gyroscopes.

    Speeds do not depend on frames. Truth streams with a common lag are reported as one clock.

    Args:
        streams: Streams of a session.

    Yields:
        Findings.
    """
    signals = [(r, s) for r in streams.every if (s := _speed(r)) is not None]
    if len(signals) < 2:
        return
    count = len(signals)
    lags, known = np.zeros((count, count)), np.zeros((count, count), dtype=bool)
    at_once = np.zeros((count, count), dtype=bool)
    for i, j in combinations(range(count), 2):
        lag, at_once[i, j] = _lag(signals[i][1], signals[j][1])
        if lag is not None:
            lags[i, j], lags[j, i] = lag, -lag
            known[i, j] = known[j, i] = True
    delays = _delays(lags, known)
    is_truth = np.array([any(r is t for t in streams.truth) for r, _ in signals])
    delays -= np.median(delays if is_truth.all() else delays[~is_truth])
    if np.any(at_once & (np.abs(np.subtract.outer(delays, delays)) > _ALIKE_LAGS)):
        return  # delays contradict pairs of streams that move simultaneously
    agreed = known.sum(axis=1) >= np.minimum(_AGREE, count - 1)
    agreed &= _share_alike(lags, delays, known) >= _MOST
    yield from _findings(signals, delays, agreed, is_truth)


def _share_alike(lags: Array, delays: Array, known: NDArray[np.bool_]) -> Array:
    """Share (J,) of each stream's known lags that are consistent with `delays` (J,), s.

    Short motions correlate at some lag by chance, but at a different one for each pair.
    """
    alike = known & (np.abs(lags - np.subtract.outer(delays, delays)) < _ALIKE_LAGS)
    return np.asarray(alike.sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def _findings(
    signals: list[tuple[Readings, tuple[Array, Array]]],
    delays: Array,
    agreed: NDArray[np.bool_],
    is_truth: NDArray[np.bool_],
) -> Iterator[Finding]:
    off = (np.abs(delays) > _LEAST) & agreed
    if off[is_truth].sum() > 1 and off[is_truth].mean() > 0.6:
        value = float(np.median(delays[is_truth]))
        if np.median(np.abs(delays[is_truth] - value)) < _LEAST < abs(value):  # else no one clock
            names = tuple(r.label for (r, _), t in zip(signals, is_truth, strict=True) if t)
            yield _lag_finding(f"The truth ({listed(names)}) moves", value, names)
        off &= ~is_truth
    for (r, _), value, bad in zip(signals, delays, off, strict=True):
        if bad:
            yield _lag_finding(f"{r.label!r} moves", float(value), (r.label,))


def _lag_finding(subject: str, value: float, names: tuple[str, ...]) -> Finding:
    later = "later" if value > 0.0 else "earlier"
    by = f"{abs(value):.2g} s"
    mend = f"subtract {by} from" if value > 0.0 else f"add {by} to"
    return Finding(
        "lag",
        f"{subject} {by} {later} than the other streams: unless its part of the robot moves by "
        f"itself, their clocks differ; {mend} its times, or give it an uncertain time_offset.",
        abs(value) > 1.0, names, later,
    )  # fmt: skip


def _speed(r: Readings) -> tuple[Array, Array] | None:
    """Times and speeds of a stream: rotation rate, else rate of its z axis or position.

    None for few readings, for a sliding sensor, and for sensors without a pose or rate.
    """
    if len(r) < 30:
        return None
    order = np.argsort(r.time, kind="stable")
    time = r.time[order]
    if r.kind == "gyro":
        return time, np.linalg.norm(r.values[order], axis=1)
    if not r.tracker or np.ptp(r.arclength) > _TRAVEL:
        return None
    pose = as_poses(r)[order]
    steps = np.diff(time)
    ok = steps > 0.0
    if weights(r)[3] > 0.0:
        moved = np.linalg.norm(np.diff(pose[:, :3, 2], axis=0), axis=-1)
    else:
        moved = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=-1)
    return (0.5 * (time[1:] + time[:-1]))[ok], moved[ok] / steps[ok]


def _lag(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[float | None, bool]:
    """Lag of the first signal behind the second, s, and whether they certainly move simultaneously.

    The lag is 0 if none improves the correlation enough, and None if unknown.
    """
    first, last = max(one[0][0], other[0][0]), min(one[0][-1], other[0][-1])
    if last - first < 3.0:
        return None, False
    grid = np.arange(first, last, 1.0 / _RATE)
    if grid.size > 200_000:
        return None, False
    box = np.ones(_SMOOTH) / _SMOOTH
    a, b = (np.convolve(np.sqrt(np.interp(grid, t, v)), box, "same") for t, v in (one, other))
    reach = int(_FARTHEST * grid.size)
    scores = _correlations(a, b, reach)
    best, without_lag = int(np.argmax(scores)), scores[reach]
    if scores[best] < _ALIKE:
        return None, False
    if (
        scores[best] - without_lag < max(_BETTER, 0.3 * (1.0 - without_lag))
        or abs(without_lag) > _AT_ONCE
    ):
        return 0.0, bool(without_lag > _AT_ONCE)
    if max(_repetition(signal, abs(best - reach)) for signal in (a, b)) > _AGAIN:
        return None, False  # repetitive motion: the lag is ambiguous
    return (best - reach) / _RATE, False


def _repetition(signal: Array, lag: int) -> float:
    """Rise of a signal's autocorrelation at a lag above its minimum at smaller lags."""
    own = _correlations(signal, signal, lag)[lag:]
    return float(own[-1] - own.min())


def _correlations(a: Array, b: Array, reach: int) -> Array:
    """Correlations (2 reach + 1,) of signals a, b at lags −reach … reach of the first, samples."""
    out = np.zeros(2 * reach + 1)
    count = a.size
    size = 1 << (2 * count - 1).bit_length()

    def total(x: Array, y: Array) -> Array:
        """Sums of x[k + lag] y[k] over all k inside both signals."""
        product = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)
        return np.concatenate([product[size - reach :], product[: reach + 1]])

    one = np.ones(count)
    n = np.maximum(total(one, one), 1.0)
    sum_a, sum_b = total(a, one), total(one, b)
    cov = total(a, b) / n - sum_a * sum_b / n**2
    var_a = total(a * a, one) / n - (sum_a / n) ** 2
    var_b = total(one, b * b) / n - (sum_b / n) ** 2
    good = (var_a > 1e-12) & (var_b > 1e-12)
    out[good] = cov[good] / np.sqrt(var_a[good] * var_b[good])
    return out


def _delays(lags: Array, known: NDArray[np.bool_]) -> Array:
    """Delay (J,) of each stream, s, from lags (J, J) of pairs, by iterated medians."""
    delays = np.zeros(len(lags))
    for _ in range(10):
        for j in range(len(lags)):
            if known[j].any():
                delays[j] = np.median((lags[j] + delays)[known[j]])
    return delays
