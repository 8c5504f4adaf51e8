"""Mistakes of clocks, noise and gyroscopes, of streams and robots."""

from dataclasses import replace

import numpy as np

from glissando.geometry import se3
from mistake_kinds import MISTAKES, mistake, names, one, placed, poses_of, timed

# Clocks


def _clock(factor):
    def make(rng, session):
        return timed(session, names(session.sensors + session.truth), lambda t: factor * t)

    return make


for _name, _factor in (
    ("ms", 1e3),
    ("µs", 1e6),
    ("ns", 1e9),
    ("minutes", 1 / 60),
    ("hours", 1 / 3600),
):
    MISTAKES[f"all times in {_name}"] = (_clock(_factor), frozenset(("time-unit", "speed", "gyro")))


@mistake("time-unit", "clock")
def one_sensor_in_ms(rng, session):
    return timed(session, one(rng, session.sensors), lambda t: 1e3 * t)


@mistake("time-unit", "clock")
def truth_in_ms(rng, session):
    return timed(session, names(session.truth), lambda t: 1e3 * t)


@mistake("clock")
def one_sensor_by_the_epoch(rng, session):
    return timed(session, one(rng, session.sensors), lambda t: t + 1.7e9)


@mistake("clock")
def truth_by_the_epoch(rng, session):
    return timed(session, names(session.truth), lambda t: t + 1.7e9)


@mistake("lag", "slide")
def one_sensor_late(rng, session):
    late = rng.uniform(0.4, 1.5) * rng.choice([-1.0, 1.0])
    return timed(session, one(rng, session.sensors), lambda t: t + late)


@mistake("lag", "clock")
def truth_late(rng, session):
    late = rng.uniform(1.0, 3.0) * rng.choice([-1.0, 1.0])
    return timed(session, names(session.truth), lambda t: t + late)


@mistake("clock")
def a_clock_that_jumps(rng, session):
    which = one(rng, session.sensors)
    jump = rng.choice([60.0, 3600.0, 1.7e9])
    return timed(session, which, lambda t: t + jump * (t > np.quantile(t, rng.uniform(0.3, 0.7))))


@mistake("sampling")
def stamps_rounded(rng, session):
    step = rng.choice([0.2, 0.5, 1.0])
    return timed(session, one(rng, session.sensors), lambda t: step * np.floor(t / step))


@mistake("lag", "clock")
def a_clock_too_fast(rng, session):
    rate = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.1)
    return timed(session, one(rng, session.sensors), lambda t: t[0] + rate * (t - t[0]))


@mistake("sampling")
def every_row_twice(rng, session):
    which = one(rng, session.sensors)
    return session.changed(lambda r: r.select(np.repeat(np.arange(len(r)), 2)), which)


@mistake("sampling")
def a_value_that_freezes(rng, session):
    def change(r):
        first = int(rng.uniform(0.2, 0.5) * len(r))
        last = first + int(0.3 * len(r))
        values = r.values.copy()
        values[first:last] = values[first]
        return r.changed(values=values)

    return session.changed(change, one(rng, poses_of(session.sensors)))


# Noise


def _noise(factor):
    def make(rng, session):
        return session.changed(
            lambda r: r.changed(cov=factor(r.cov)), one(rng, poses_of(session.sensors))
        )

    return make


def _angles(cov):
    scale = np.diag([1.0] * 3 + [180.0 / np.pi] * (cov.shape[-1] - 3))
    return scale @ cov @ scale


MISTAKES["noise in mm"] = (_noise(lambda cov: 1e6 * cov), frozenset(["noise"]))
MISTAKES["noise 1,000 times too small"] = (_noise(lambda cov: 1e-6 * cov), frozenset(["noise"]))
MISTAKES["variances for standard deviations"] = (
    _noise(lambda cov: cov @ cov),
    frozenset(["noise"]),
)
MISTAKES["noise of angles in degrees"] = (_noise(_angles), frozenset(["noise"]))


# Gyroscopes


def _gyro(change):
    def make(rng, session):
        which = one(rng, [r for r in session.sensors if r.kind == "gyro"])
        if not which:
            return None
        return session.changed(lambda r: r.changed(values=change(rng, r.values)), which)

    return make


for _name, _change in (
    ("in deg/s", lambda rng, w: w * 180.0 / np.pi),
    ("called deg/s", lambda rng, w: w * np.pi / 180.0),
    ("in mrad/s", lambda rng, w: 1e3 * w),
    ("in rpm", lambda rng, w: w * 30.0 / np.pi),
    ("with the wrong sign", lambda rng, w: -w),
    (
        "with two axes swapped",
        lambda rng, w: w[:, rng.permutation([[1, 0, 2], [2, 1, 0], [0, 2, 1]])[0]],
    ),
    ("with one sign wrong", lambda rng, w: w * rng.permutation([-1.0, 1.0, 1.0])),
):
    MISTAKES[f"a gyro {_name}"] = (_gyro(_change), frozenset(["gyro"]))


# Streams and robot


@mistake("shape", "slide", "gyro", "base", "frame", "length-unit", "axes", "mount")
def two_trackers_exchanged(rng, session):
    streams = poses_of(session.sensors)
    if len(streams) < 2:
        return None
    a, b = (streams[i] for i in rng.choice(len(streams), 2, replace=False))
    place = {a.name: float(np.median(b.arclength)), b.name: float(np.median(a.arclength))}
    return placed(session, tuple(place), lambda r: np.full(len(r), place[r.name]))


@mistake("shape", "slide", "base", "frame", "length-unit", "axes", "mount")
def truth_bodies_exchanged(rng, session):
    streams = poses_of(session.truth)
    if len(streams) < 2:
        return None
    order = rng.permutation(len(streams))
    order = np.roll(order, 1)[np.argsort(order)]
    place = {
        r.name: float(np.median(streams[k].arclength)) for r, k in zip(streams, order, strict=True)
    }
    return placed(session, tuple(place), lambda r: np.full(len(r), place[r.name]))


@mistake("base", "frame", "shape", "axes")
def base_moved(rng, session):
    prior = session.robot.prior
    step = rng.normal(size=3)
    pose = np.array(prior.base_pose)
    pose[:3, 3] += step * rng.uniform(0.3, 1.0) * session.robot.length / np.linalg.norm(step)
    return replace(session, robot=replace(session.robot, prior=replace(prior, base_pose=pose)))


@mistake("base", "frame", "shape", "axes", "mount")
def base_turned(rng, session):
    prior = session.robot.prior
    turn = np.zeros(6)
    turn[3 + rng.integers(2)] = rng.choice([0.5, 1.0]) * np.pi
    base = prior.base_pose @ se3.exp(turn)
    return replace(session, robot=replace(session.robot, prior=replace(prior, base_pose=base)))


@mistake("grid")
def time_rate_far_too_high(rng, session):
    rate = session.robot.time_rate * rng.choice([300.0, 1000.0])
    return replace(session, robot=replace(session.robot, time_rate=rate))


@mistake("reach")
def one_reading_far_away(rng, session):
    def change(r):
        values = r.values.copy()
        step = rng.normal(size=3)
        values[rng.integers(len(r)), :3, 3] += rng.choice([2.0, 1e3]) * step / np.linalg.norm(step)
        return r.changed(values=values)

    return session.changed(change, one(rng, poses_of(session.sensors)))
