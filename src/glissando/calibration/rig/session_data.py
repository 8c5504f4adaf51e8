"""Rig data from a raw session log."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.calibration.rig.rig import Body, Noise, RigData, TubeBody
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.session_log import RawSession, Topic
from glissando.io.session_recording import session_setup
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel

_NOISE = {"mocap": "mocap_std", "coil": "coil_std", "bias": "coil_bias", "play": "play"}
_TRACKER, _MOCAP, _SLIDE = "/tracker/", "/mocap/", "/slide"


def rig_data(session: RawSession) -> RigData:
    """The data of a session's devices, as its metadata 'setup' describes them.

    Args:
        session: Raw session log. Repeated frames count once, poses that are null are left out.

    Raises:
        RecordingError: If the setup or a tracker topic is missing or wrong, if there are several
            coils and the setup names none, or if a body has no place.
    """
    setup = Table(session_setup(session), "setup", RecordingError)
    name, time, coil = _coil(session, setup)
    slide_time, travel = _slide(session)
    bodies, tube = _bodies(session, setup)
    direction = setup.number("direction", 0.0, positive=False)
    if direction not in (-1.0, 0.0, 1.0):
        raise setup.fail("direction", f"is {direction:g}; give 1, -1, or 0 for not known.")
    return RigData(
        coil_name=name,
        coil_time=time,
        coil=coil,
        slide_time=slide_time,
        travel=travel,
        bodies=bodies,
        coil_arclength=setup.number("coil_arclength", positive=False),
        coil_arclength_std=setup.number("coil_arclength_std"),
        direction=int(direction),
        noise=_noise(setup),
        robot=setup.text("robot", ""),
        tube=tube,
        channel=_channel(setup, name),
    )


def _noise(setup: Table) -> Noise:
    """Noise as the setup states it, presets where it does not."""
    preset = Noise()
    stated: dict[str, Any] = {"backlash": setup.number("backlash", preset.backlash)}
    for part, key in _NOISE.items():
        usual = getattr(preset, part)
        stated[part] = setup.vector(key, usual.size, usual, positive=True)
    return Noise(**stated)


def _coil(session: RawSession, setup: Table) -> tuple[str, Array, Array]:
    names = [topic.removeprefix(_TRACKER) for topic in session.topics if topic.startswith(_TRACKER)]
    if not names:
        raise RecordingError(
            f"The session has no topic {_TRACKER}NAME: without the tracker there is nothing to "
            f"calibrate; record it too."
        )
    wanted = setup.peek("coil")
    if wanted is None and len(names) > 1:
        raise RecordingError(
            f"The session has coils {', '.join(sorted(names))}; say which one slides: "
            f'"coil": NAME in the setup.'
        )
    name = names[0] if wanted is None else setup.text("coil", choices=names)
    time, poses = _poses(session.topics[_TRACKER + name])
    return name, time, poses


def _channel(setup: Table, name: str) -> Channel | None:
    """The channel that the setup states of a coil."""
    entry = dict(setup.named_tables("coils")).get(name)
    return entry.channel() if entry else None


def _poses(topic: Topic) -> tuple[Array, Array]:
    """Times (M,) and poses (M, 4, 4) that were seen, in the order of time, each frame once."""
    time, frame = topic.column("time"), topic.column("frame")
    position, quaternion = topic.column("position"), topic.column("quaternion")
    if position.ndim != 2 or quaternion.ndim != 2:  # nothing was ever seen
        return np.zeros(0), np.zeros((0, 4, 4))
    if position.shape[1] != 3 or quaternion.shape[1] != 4:
        raise RecordingError(
            f"Topic {topic.name!r}: give positions of 3 numbers and quaternions [w, x, y, z]."
        )
    seen = np.isfinite(time) & np.all(np.isfinite(np.hstack([position, quaternion])), axis=1)
    seen &= np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) < 0.01
    rows = np.flatnonzero(seen)
    rows = rows[np.argsort(time[rows], kind="stable")]
    again = np.append(False, frame[rows][1:] == frame[rows][:-1]) if rows.size else rows > 0
    rows = rows[~again]
    rotation = se3.rotation_from_quaternion(quaternion[rows])
    return time[rows], se3.pose(rotation, position[rows])


def _slide(session: RawSession) -> tuple[Array, Array]:
    topic = session.topics.get(_SLIDE)
    if topic is None:
        return np.zeros(0), np.zeros(0)
    time, travel = topic.column("time"), topic.column("travel")
    rows = np.flatnonzero(np.isfinite(time) & np.isfinite(travel))
    time, first = np.unique(time[rows], return_index=True)
    return time, travel[rows][first]


def _bodies(session: RawSession, setup: Table) -> tuple[dict[str, Body], TubeBody | None]:
    """The bodies on the robot, and the one on the sliding tube."""
    given = setup.table("bodies")
    known = given.names() if given else []
    out, tubes = {}, []
    for topic in session.topics.values():
        name = topic.name.removeprefix(_MOCAP)
        if not topic.name.startswith(_MOCAP):
            continue
        if given is None or name not in known:
            raise RecordingError(
                f"Motion capture saw {name!r}, and the setup does not say where it sits; add it to "
                f"its bodies with arclength, position and quaternion."
            )
        entry = given.subtable(name)
        time, poses = _poses(topic)
        if entry.flag("slides"):
            tubes.append(TubeBody(name, time, poses))
        else:
            arclength, mount = entry.number("arclength", positive=False), entry.pose()
            if time.size:
                out[name] = Body(arclength, mount, time, poses)
    if len(tubes) > 1:
        raise RecordingError(
            f"Bodies {', '.join(tube.name for tube in tubes)} are on the sliding tube; leave "
            f"`slides` to one of them."
        )
    return out, tubes[0] if tubes and tubes[0].time.size else None
