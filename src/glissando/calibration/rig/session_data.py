"""Rig data from a raw session log."""

from __future__ import annotations

from typing import Any

from glissando.calibration.rig.rig import Body, Noise, RigData, TubeBody
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.session_log import RawSession
from glissando.io.session_recording import seen_poses, seen_travels, session_setup
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel

_NOISE = {"mocap": "mocap_std", "coil": "coil_std", "bias": "coil_bias", "play": "play"}
_TRACKER, _MOCAP = "/tracker/", "/mocap/"


def rig_data(session: RawSession) -> RigData:
    """The data of a session's devices, as its metadata 'setup' describes them.

    Args:
        session: Raw session log. Repeated frames count once, poses that are null are left out.

    Raises:
        RecordingError: If the setup or a tracker topic is missing or wrong, if the setup has a key
            that means nothing, if there are several coils and the setup names none, or if a body
            has no place.
    """
    setup = Table(session_setup(session), "setup", RecordingError)
    name, time, coil = _coil(session, setup)
    slide_time, travel = seen_travels(session.topics.get("/slide"))
    bodies, tube = _bodies(session, setup)
    direction = setup.number("direction", 0.0, positive=False)
    if direction not in (-1.0, 0.0, 1.0):
        raise setup.fail("direction", f"is {direction:g}; give 1, -1, or 0 for not known.")
    data = RigData(
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
    for key in ("name", "frame"):  # for the recording that a session is
        setup.skip(key)
    setup.close()
    return data


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
    if wanted is None:
        setup.skip("coil")
    if wanted is None and len(names) > 1:
        raise RecordingError(
            f"The session has coils {', '.join(sorted(names))}; say which one slides: "
            f'"coil": NAME in the setup.'
        )
    name = names[0] if wanted is None else setup.text("coil", choices=names)
    return name, *seen_poses(session.topics[_TRACKER + name])


def _channel(setup: Table, name: str) -> Channel | None:
    """The channel that the setup states of a coil."""
    entry = dict(setup.named_tables("coils")).get(name)
    return entry.channel() if entry else None


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
        time, poses = seen_poses(topic)
        if entry.flag("slides"):
            tubes.append(TubeBody(name, time, poses))
            for key in ("arclength", "position", "quaternion"):  # of one on the robot
                entry.skip(key)
        else:
            arclength, mount = entry.number("arclength", positive=False), entry.pose()
            if time.size:
                out[name] = Body(arclength, mount, time, poses)
        entry.close()
    if len(tubes) > 1:
        raise RecordingError(
            f"Bodies {', '.join(tube.name for tube in tubes)} are on the sliding tube; leave "
            f"`slides` to one of them."
        )
    return out, tubes[0] if tubes and tubes[0].time.size else None
