"""Mistakes of exports: wrong rotation vectors, exchanged columns and rows, other robots."""

from dataclasses import replace

import numpy as np

from glissando.geometry import se3
from mistake_kinds import MISTAKES, mistake, names, on_poses, one, poses_of

_SEEN = (
    "axes", "base", "frame", "lag", "length-unit", "mount", "noise", "quaternion", "reach",
    "shape", "slide", "speed",
)  # fmt: skip
"""Checks that say that poses are not what they are said to be."""


def _rotation_vectors(part, factor):
    def change(pose):
        out = pose.copy()
        out[..., :3, :3] = se3.so3_exp(factor * se3.so3_log(pose[..., :3, :3]))
        return out

    def make(rng, session):
        return on_poses(session, names(poses_of(getattr(session, part))), change)

    return make


for _part, _label in (("sensors", "trackers"), ("truth", "truth")):
    for _what, _factor in (("in degrees", 180.0 / np.pi), ("called degrees", np.pi / 180.0)):
        MISTAKES[f"{_label}: rotation vectors {_what}"] = (
            _rotation_vectors(_part, _factor),
            frozenset((*_SEEN, "gyro")),
        )


@mistake(*_SEEN)
def logarithms_with_the_angle_first(rng, session):
    which = names(poses_of(session.sensors))
    return on_poses(session, which, lambda p: se3.exp(se3.log(p)[..., [3, 4, 5, 0, 1, 2]]))


@mistake(*_SEEN)
def positions_taken_for_logarithms(rng, session):
    """Position and rotation vector, read as the logarithm of the pose."""

    def change(pose):
        turn = se3.so3_log(pose[..., :3, :3])
        return se3.exp(np.concatenate([pose[..., :3, 3], turn], axis=-1))

    return on_poses(session, names(poses_of(session.sensors)), change)


@mistake(*_SEEN)
def logarithms_taken_for_positions(rng, session):
    def change(pose):
        out = pose.copy()
        out[..., :3, 3] = se3.log(pose)[..., :3]
        return out

    return on_poses(session, names(poses_of(session.truth)), change)


@mistake(*_SEEN)
def tared_at_the_start(rng, session):
    """Poses relative to the first, as after zeroing in a tracker's program."""
    which = names(poses_of(session.sensors))
    return on_poses(session, which, lambda p: se3.inverse(p[0]) @ p)


@mistake(*_SEEN)
def x_copied_into_y(rng, session):
    def change(pose):
        out = pose.copy()
        out[..., 1, 3] = pose[..., 0, 3]
        return out

    return on_poses(session, one(rng, poses_of(session.sensors)), change)


@mistake(*_SEEN, "gyro")
def played_backwards(rng, session):
    which = one(rng, poses_of(session.sensors))
    return session.changed(lambda r: r.changed(values=r.values[::-1]), which) if which else None


def _pair(rng, streams):
    """Two random streams; None if there are fewer."""
    if len(streams) < 2:
        return None
    return [streams[i] for i in rng.choice(len(streams), 2, replace=False)]


@mistake(*_SEEN)
def positions_of_two_coils_exchanged(rng, session):
    """Positions of two coils exchanged, rotations unchanged."""
    pair = _pair(rng, poses_of(session.sensors))
    if pair is None:
        return None
    count = min(map(len, pair))
    place = {
        a.name: (session.frame(a) @ se3.inverse(session.frame(b)) @ b.values[:count])[:, :3, 3]
        for a, b in (pair, pair[::-1])
    }

    def change(r):
        r = r.select(np.arange(count))
        values = r.values.copy()
        values[:, :3, 3] = place[r.name]
        return r.changed(values=values)

    return session.changed(change, tuple(place))


@mistake(*_SEEN, "sampling")
def two_coils_in_one_stream(rng, session):
    """Every second row is from another coil."""
    pair = _pair(rng, poses_of(session.sensors))
    if pair is None:
        return None
    one_of, other = pair
    rows = np.searchsorted(other.time, one_of.time).clip(0, len(other) - 1)
    values = one_of.values.copy()
    values[1::2] = other.values[rows[1::2]]
    return session.changed(lambda r: r.changed(values=values), (one_of.name,))


@mistake("gyro")
def gyroscopes_exchanged(rng, session):
    pair = _pair(rng, [r for r in session.sensors if r.kind == "gyro"])
    if pair is None:
        return None
    place = {a.name: np.median(b.arclength) for a, b in (pair, pair[::-1])}
    return session.changed(
        lambda r: r.changed(arclength=np.full(len(r), place[r.name])), tuple(place)
    )


@mistake("gyro")
def angles_for_turn_rates(rng, session):
    which = one(rng, [r for r in session.sensors if r.kind == "gyro"])

    def change(r):
        step = np.diff(r.time, prepend=r.time[0])[:, None]
        return r.changed(values=np.cumsum(step * r.values, axis=0))

    return session.changed(change, which) if which else None


@mistake(*_SEEN)
def truth_of_another_motion(rng, session):
    """Motion capture of another time: the values are shifted by half the recording."""
    which = names(session.truth)
    return (
        session.changed(lambda r: r.changed(values=np.roll(r.values, len(r) // 2, 0)), which)
        if which
        else None
    )


def _length(factor):
    def make(rng, session):
        """Another length in the robot file, with sensors and truth at the same fractions of it."""
        every = {r.name: factor * r.arclength for r in session.sensors + session.truth}
        session = session.changed(lambda r: r.changed(arclength=every[r.name]), tuple(every))
        robot, prior = session.robot, session.robot.prior
        if len(prior.joints):
            prior = replace(prior, joints=factor * np.asarray(prior.joints))
        length, nodes = factor * robot.length, factor * robot.arclength_nodes
        return replace(
            session, robot=replace(robot, length=length, arclength_nodes=nodes, prior=prior)
        )

    return make


for _name, _factor in (("half", 0.5), ("one and a half times", 1.5)):
    MISTAKES[f"a robot of {_name} the length"] = (_length(_factor), frozenset(_SEEN))
