"""Mistakes of lengths, slides, rotations, frames and axes."""

import numpy as np

from glissando.geometry import se3
from mistake_kinds import (
    MISTAKES,
    matrix_of,
    mistake,
    names,
    on_poses,
    one,
    place,
    placed,
    poses_of,
    scale,
    shuffle,
    sliding,
    transpose,
    wrong_frame,
)

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
