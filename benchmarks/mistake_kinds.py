"""Mistakes of a newcomer, drawn at random and applied to a session in memory.

Each takes a random generator and a session, and gives the session with the mistake, or None where
it cannot be made. `MISTAKES` names them all, with the checks that name them rightly.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from glissando.geometry import se3
from glissando.model.robot import Robot


@dataclass(frozen=True)
class Session:
    """What goes into an estimate: a robot, sensors, truth, and the frames streams came in."""

    robot: Robot
    sensors: tuple
    truth: tuple
    frames: dict = field(default_factory=dict)

    def frame(self, r):
        """The pose of the frame that a stream came in."""
        return self.frames.get(r.name, np.eye(4))

    def changed(self, change, which):
        """The session with `change` of the streams whose names are in `which`."""
        new = {
            part: tuple(change(r) if r.name in which else r for r in getattr(self, part))
            for part in ("sensors", "truth")
        }
        return replace(self, **new)


MISTAKES = {}
"""Name of each mistake: the function that makes it, and the checks that name it rightly."""


def mistake(*checks):
    def enter(function):
        MISTAKES[function.__name__] = (function, frozenset(checks))
        return function

    return enter


def poses_of(streams):
    return [r for r in streams if r.kind in ("pose", "coil")]


def one(rng, streams):
    """The name of one of the streams, as a tuple; empty if there is none."""
    streams = list(streams)
    return (streams[rng.integers(len(streams))].name,) if streams else ()


def names(streams):
    return tuple(r.name for r in streams)


def matrix_of(order, signs=(1, 1, 1)):
    out = np.zeros((3, 3))
    out[range(3), order] = signs
    return out


def raw(session, r, change):
    """The stream with its poses changed as its file has them."""
    frame = session.frame(r)
    return r.changed(values=frame @ change(se3.inverse(frame) @ r.values))


def scale(pose, k):
    out = pose.copy()
    out[..., :3, 3] *= k
    return out


def shuffle(pose, index):
    out = pose.copy()
    out[..., :3, :3] = se3.rotation_from_quaternion(se3.quaternion(pose[..., :3, :3])[..., index])
    return out


def transpose(pose):
    out = pose.copy()
    out[..., :3, :3] = np.swapaxes(pose[..., :3, :3], -1, -2)
    return out


def place(pose, matrix, turn=False, mirror=False):
    out = pose.copy()
    out[..., :3, 3] = pose[..., :3, 3] @ matrix.T
    if turn:
        out[..., :3, :3] = matrix @ out[..., :3, :3]
    if mirror:
        out[..., :3, :3] = matrix @ out[..., :3, :3] @ matrix.T
    return out


def on_poses(session, which, change):
    """Poses changed as files have them; None if no stream is chosen."""
    return session.changed(lambda r: raw(session, r, change), which) if which else None


def framed(rng, session):
    """The session with its poses said to be in a frame of their own, and its streams' names."""
    streams = poses_of(session.sensors)
    if not streams:
        return session, (), np.eye(4)
    known = {r.name: session.frames[r.name] for r in streams if r.name in session.frames}
    if known:
        frame = next(iter(known.values()))
        which = tuple(n for n, f in known.items() if np.array_equal(f, frame))
        return session, which, frame
    frame = se3.exp(np.concatenate([rng.normal(0.0, 0.4, 3), rng.normal(0.0, 1.2, 3)]))
    return replace(session, frames=dict.fromkeys(names(streams), frame)), names(streams), frame


def wrong_frame(rng, session, change):
    """The session with a frame that is stated wrongly."""
    session, which, frame = framed(rng, session)
    if not which:
        return None
    wrong = change(frame)
    out = session.changed(lambda r: r.changed(values=wrong @ se3.inverse(frame) @ r.values), which)
    return replace(out, frames={**session.frames, **dict.fromkeys(which, wrong)})


def timed(session, which, change):
    return session.changed(lambda r: r.changed(time=change(r.time)), which) if which else None


def placed(session, which, change):
    return session.changed(lambda r: r.changed(arclength=change(r)), which) if which else None


def sliding(session):
    return [r for r in poses_of(session.sensors) if np.ptp(r.arclength) > 5e-3]


# Units of length


def _unit(part, factor):
    def make(rng, session):
        streams = poses_of(getattr(session, part))
        return on_poses(session, names(streams), lambda pose: scale(pose, factor))

    return make


for _part, _label in (("sensors", "trackers"), ("truth", "truth")):
    for _word, _factor in (("mm", 1e3), ("cm", 1e2), ("inches", 39.37), ("m called mm", 1e-3)):
        MISTAKES[f"{_label} in {_word}"] = (
            _unit(_part, _factor),
            frozenset(("length-unit", "reach")),
        )


@mistake("length-unit", "reach")
def one_tracker_in_mm(rng, session):
    return on_poses(session, one(rng, poses_of(session.sensors)), lambda p: scale(p, 1e3))


@mistake("length-unit", "reach")
def one_truth_in_mm(rng, session):
    return on_poses(session, one(rng, poses_of(session.truth)), lambda p: scale(p, 1e3))


@mistake("frame", "base", "shape", "length-unit", "reach")
def frame_in_mm(rng, session):
    return wrong_frame(rng, session, lambda frame: scale(frame, 1e3))


@mistake("length-unit", "mount", "reach", "shape", "base")
def mount_in_mm(rng, session):
    which = one(rng, poses_of(session.sensors))
    offset = np.eye(4)
    offset[:3, 3] = rng.uniform(2.0, 6.0, 3)
    return on_poses(session, which, lambda pose: pose @ offset)


@mistake("reading")
def arclength_in_mm(rng, session):
    return placed(session, one(rng, session.sensors), lambda r: 1e3 * r.arclength)


@mistake("slide", "shape", "length-unit")
def arclength_called_mm(rng, session):
    return placed(session, one(rng, poses_of(session.sensors)), lambda r: 1e-3 * r.arclength)


@mistake("slide", "shape", "length-unit")
def arclength_in_half(rng, session):
    return placed(session, one(rng, poses_of(session.sensors)), lambda r: 0.5 * r.arclength)


@mistake("slide", "shape")
def arclength_from_the_tip(rng, session):
    length = session.robot.length
    return placed(session, one(rng, poses_of(session.sensors)), lambda r: length - r.arclength)


@mistake("slide", "shape")
def truth_arclength_from_the_tip(rng, session):
    length = session.robot.length
    return placed(session, names(session.truth), lambda r: length - r.arclength)


# The slide


@mistake("slide")
def slide_reversed(rng, session):
    def change(r):
        return r.arclength.min() + r.arclength.max() - r.arclength

    return placed(session, names(sliding(session)), change)


@mistake("slide", "reading")
def slide_twice_as_far(rng, session):
    factor = rng.choice([2.0, 2.54, 0.5, 0.3])
    top = session.robot.length

    def change(r):
        return top - factor * (top - r.arclength)

    return placed(session, names(sliding(session)), change)


@mistake("slide")
def slide_forgotten(rng, session):
    return placed(
        session, names(sliding(session)), lambda r: np.full(len(r), np.median(r.arclength))
    )


@mistake("slide", "lag")
def slide_late(rng, session):
    late = rng.uniform(0.4, 1.2) * rng.choice([-1.0, 1.0])
    return placed(
        session, names(sliding(session)), lambda r: np.interp(r.time - late, r.time, r.arclength)
    )


@mistake("slide", "shape")
def slide_zero_off(rng, session):
    off = rng.uniform(0.08, 0.15) * session.robot.length
    return placed(session, names(sliding(session)), lambda r: np.clip(r.arclength - off, 0.0, None))


# Rotations


@mistake("quaternion", "axes", "mount")
def quaternions_xyzw(rng, session):
    which = names(poses_of(session.sensors))
    return on_poses(session, which, lambda p: shuffle(p, [1, 2, 3, 0]))


@mistake("quaternion", "axes", "mount")
def quaternions_of_one_xyzw(rng, session):
    which = one(rng, poses_of(session.sensors))
    return on_poses(session, which, lambda p: shuffle(p, [1, 2, 3, 0]))


@mistake("quaternion", "axes", "mount")
def quaternions_cycled(rng, session):
    which = one(rng, poses_of(session.sensors))
    return on_poses(session, which, lambda p: shuffle(p, [3, 0, 1, 2]))


@mistake("quaternion", "axes", "mount")
def truth_quaternions_xyzw(rng, session):
    return on_poses(session, names(poses_of(session.truth)), lambda p: shuffle(p, [1, 2, 3, 0]))


@mistake("quaternion")
def rotations_inverted(rng, session):
    return on_poses(session, one(rng, poses_of(session.sensors)), transpose)


@mistake("quaternion")
def all_rotations_inverted(rng, session):
    return on_poses(session, names(poses_of(session.sensors)), transpose)


@mistake("quaternion")
def truth_rotations_inverted(rng, session):
    return on_poses(session, names(poses_of(session.truth)), transpose)


@mistake("frame", "quaternion", "base")
def poses_inverted(rng, session):
    return on_poses(session, names(poses_of(session.sensors)), se3.inverse)


@mistake("frame", "quaternion", "base")
def truth_poses_inverted(rng, session):
    return on_poses(session, names(poses_of(session.truth)), se3.inverse)


# Frames


@mistake("frame", "base", "shape")
def frame_inverted(rng, session):
    return wrong_frame(rng, session, se3.inverse)


@mistake("frame", "base", "shape")
def frame_left_out(rng, session):
    return wrong_frame(rng, session, lambda frame: np.eye(4))


@mistake("frame", "base", "shape", "quaternion")
def frame_xyzw(rng, session):
    return wrong_frame(rng, session, lambda frame: shuffle(frame, [1, 2, 3, 0]))


@mistake("frame", "base", "shape", "quaternion")
def frame_cycled(rng, session):
    return wrong_frame(rng, session, lambda frame: shuffle(frame, [3, 0, 1, 2]))


@mistake("frame", "base", "shape", "quaternion")
def frame_rotation_inverted(rng, session):
    return wrong_frame(rng, session, transpose)


@mistake("frame", "base", "shape", "axes")
def frame_a_quarter_off(rng, session):
    turn = np.zeros(6)
    turn[3 + rng.integers(3)] = rng.choice([-1.0, 1.0]) * np.pi / 2
    return wrong_frame(rng, session, lambda frame: frame @ se3.exp(turn))


@mistake("frame", "base", "shape", "axes", "reach")
def frame_moved(rng, session):
    step = np.zeros(6)
    step[:3] = rng.normal(0.0, 1.0, 3)
    step[:3] *= rng.uniform(0.3, 1.0) * session.robot.length / np.linalg.norm(step[:3])
    return wrong_frame(rng, session, lambda frame: se3.exp(step) @ frame)


@mistake("axes", "frame", "base", "shape")
def truth_turned(rng, session):
    turn = np.zeros(6)
    turn[3:] = rng.normal(size=3)
    turn[3:] *= rng.uniform(0.7, np.pi) / np.linalg.norm(turn[3:])
    pose, which = se3.exp(turn), names(poses_of(session.truth))
    return session.changed(lambda r: r.changed(values=pose @ r.values), which) if which else None


# Axes


def _swapped(part, order, signs, **how):
    def make(rng, session):
        which = names(poses_of(getattr(session, part)))
        matrix = matrix_of(order, signs)
        return on_poses(session, which, lambda p: place(p, matrix, **how))

    return make


for _name, _order, _signs, _how in (
    ("x and y swapped", (1, 0, 2), (1, 1, 1), {}),
    ("y and z swapped", (0, 2, 1), (1, 1, 1), {}),
    ("x and z swapped", (2, 1, 0), (1, 1, 1), {}),
    ("x negated", (0, 1, 2), (-1, 1, 1), {}),
    ("z negated", (0, 1, 2), (1, 1, -1), {}),
    ("y up", (0, 2, 1), (1, -1, 1), {"turn": True}),
    ("x up", (2, 0, 1), (1, 1, 1), {"turn": True}),
    ("left-handed", (0, 1, 2), (1, -1, 1), {"mirror": True}),
    ("left-handed by a swap", (1, 0, 2), (1, 1, 1), {"mirror": True}),
):
    for _part, _label in (("sensors", "trackers"), ("truth", "truth")):
        MISTAKES[f"{_label}: {_name}"] = (
            _swapped(_part, _order, _signs, **_how),
            frozenset(("axes", "frame", "base", "shape", "mount", "gyro")),
        )


def _mounted(part, turn):
    def make(rng, session):
        which = one(rng, poses_of(getattr(session, part)))
        twist = se3.exp(np.array([0.0, 0.0, 0.0, *turn]))
        return on_poses(session, which, lambda pose: pose @ twist)

    return make


for _name, _turn in (("x", [0, np.pi / 2, 0]), ("y", [np.pi / 2, 0, 0]), ("−z", [np.pi, 0, 0])):
    for _part, _label in (("sensors", "tracker"), ("truth", "truth")):
        MISTAKES[f"{_label} with {_name} along the robot"] = (
            _mounted(_part, _turn),
            frozenset(("mount", "slide", "quaternion")),
        )


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
