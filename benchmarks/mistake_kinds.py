"""Mistakes of a newcomer, drawn at random and applied to a session in memory.

Each takes a random generator and a session, and gives the session with the mistake, or None where
it cannot be made. `MISTAKES` names them all, with the checks that name them rightly, once
`mistakes_of_place` and `mistakes_of_streams` are imported.
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
