"""Random mistakes of new users, applied to a session in memory.

Each function takes a random generator and a session, and returns the session with the mistake, or
None if it is not applicable. `MISTAKES` has them all, with the checks that identify them correctly,
once `mistakes_of_place` and `mistakes_of_streams` are imported.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from glissando.geometry import se3
from glissando.model.robot import Robot


@dataclass(frozen=True)
class Session:
    """Input of an estimate: robot, sensors, truth, and frames of the streams in their files."""

    robot: Robot
    sensors: tuple
    truth: tuple
    frames: dict = field(default_factory=dict)

    def frame(self, r):
        """Pose (4, 4) of the frame of a stream's file in the world."""
        return self.frames.get(r.name, np.eye(4))

    def changed(self, change, which):
        """Session with `change` applied to the streams named in `which`."""
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
    """Name of a random stream, as a tuple; empty if there is none."""
    streams = list(streams)
    return (streams[rng.integers(len(streams))].name,) if streams else ()


def names(streams):
    return tuple(r.name for r in streams)


def matrix_of(order, signs=(1, 1, 1)):
    out = np.zeros((3, 3))
    out[range(3), order] = signs
    return out


def raw(session, r, change):
    """Stream with its poses changed in the frame of its file."""
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
    """Session with the poses of streams changed in their files' frames; None without streams."""
    return session.changed(lambda r: raw(session, r, change), which) if which else None


def framed(rng, session):
    """Session with pose sensors in a frame other than the world's, their names and that frame."""
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
    """Session with a wrongly stated frame."""
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
