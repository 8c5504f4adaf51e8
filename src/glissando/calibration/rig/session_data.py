"""Conversion of a raw session log into rig data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando.calibration.rig.other_coil import OtherCoil
from glissando.calibration.rig.rig import Body, Noise, RigData, TubeBody
from glissando.errors import RecordingError
from glissando.io.session_log import RawSession
from glissando.io.session_recording import ARCLENGTH_STD, seen_poses, seen_travels, session_setup
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel

_NOISE = {"mocap": "mocap_std", "coil": "coil_std", "bias": "coil_bias", "play": "play"}
_TRACKER, _MOCAP, _SLIDE = "/tracker/", "/mocap/", "/slide"


@dataclass(frozen=True)
class _Place:
    """Place of a coil as stated in the setup.

    Attributes:
        arclength: Arclength of the coil at travel 0, m.
        std: Standard deviation of `arclength`, m.
        stage: Topic of the stage that moves the coil; empty if it is fixed.
        channel: Channel beside the backbone in which the coil slides, or None.
    """

    arclength: float
    std: float
    stage: str
    channel: Channel | None


def rig_data(session: RawSession, coil: str | None = None) -> RigData:
    """Data of a session's devices, as its metadata 'setup' describes them.

    Args:
        session: Raw session log. Repeated frames are counted once, null poses are skipped.
        coil: Name of the coil to calibrate; by default the coil named in the setup, else the only
            coil, else the only one that slides.

    Raises:
        RecordingError: If the setup or a tracker topic is missing or wrong, if the setup has an
            unknown key, if there is no such coil or the choice is ambiguous, or if a body has no
            arclength.
    """
    setup = Table(session_setup(session), "setup", RecordingError)
    coils = dict(setup.named_tables("coils"))
    name = _coil_to_calibrate(session, setup, coils, coil)
    place = _place(setup, coils.get(name))
    time, poses = seen_poses(session.topics[_TRACKER + name])
    slide_time, travel = seen_travels(session.topics.get(place.stage))
    bodies, tube = _bodies(session, setup)
    direction, frame = _direction(setup), setup.table("frame")
    data = RigData(
        coil_name=name,
        coil_time=time,
        coil=poses,
        slide_time=slide_time,
        travel=travel,
        bodies=bodies,
        coil_arclength=place.arclength,
        coil_arclength_std=place.std,
        direction=direction if slide_time.size > 1 else 0,
        noise=_noise(setup),
        robot=setup.text("robot", ""),
        tube=tube if place.stage == _SLIDE else None,  # the body is on the first stage's tube
        channel=place.channel,
        others=tuple(_others(session, setup, coils, name, place.stage)),
        frame=frame.pose() if frame else None,
    )
    setup.skip("name")
    setup.close()
    return data


def _direction(setup: Table) -> int:
    direction = setup.number("direction", 0.0, positive=False)
    if direction not in (-1.0, 0.0, 1.0):
        raise setup.fail("direction", f"is {direction:g}; give 1, -1, or 0 for not known.")
    return int(direction)


def _noise(setup: Table) -> Noise:
    """Noise as stated in the setup, with presets for missing keys."""
    preset = Noise()
    stated: dict[str, Any] = {"backlash": setup.number("backlash", preset.backlash)}
    for part, key in _NOISE.items():
        usual = getattr(preset, part)
        stated[part] = setup.vector(key, usual.size, usual, positive=True)
    return Noise(**stated)


def _coil_to_calibrate(
    session: RawSession, setup: Table, coils: Mapping[str, Table], wanted: str | None
) -> str:
    """Name of the coil to calibrate."""
    recorded = [
        topic.removeprefix(_TRACKER) for topic in session.topics if topic.startswith(_TRACKER)
    ]
    if not recorded:
        raise RecordingError(
            f"The session has no topic {_TRACKER}NAME: without the tracker there is nothing to "
            f"calibrate; record it too."
        )
    stated = None if setup.peek("coil") is None else setup.text("coil", choices=recorded)
    setup.skip("coil")
    sliding = [name for name in recorded if name in coils and coils[name].peek("slides")]
    name = wanted or stated
    if name is None and len(recorded) > 1:
        name = sliding[0] if len(sliding) == 1 else None
    elif name is None:
        name = recorded[0]
    if name is None or name not in recorded:
        lacks = f"The session has no coil {name!r}" if name else "Several coils were recorded"
        raise RecordingError(
            f"{lacks}; say with --coil which of {', '.join(sorted(recorded))} is to be calibrated."
        )
    return name


def _place(setup: Table, entry: Table | None) -> _Place:
    """Place of a coil by its entry; without an entry it slides, from the setup's coil_arclength."""
    if entry is None:
        place = setup.number("coil_arclength", positive=False)
        return _Place(place, setup.number("coil_arclength_std"), _SLIDE, None)
    std = setup.number("coil_arclength_std", ARCLENGTH_STD)
    fixed = entry.peek("slides") is not None and not entry.flag("slides")
    stage = entry.text("slide", "")
    out = _Place(
        arclength=entry.number("arclength", setup.peek("coil_arclength"), positive=False),
        std=entry.number("arclength_std", std),
        stage="" if fixed else f"{_SLIDE}/{stage}".removesuffix("/"),
        channel=entry.channel(),
    )
    setup.skip("coil_arclength")
    entry.skip("slides")
    entry.close()
    return out


def _others(
    session: RawSession, setup: Table, coils: Mapping[str, Table], name: str, stage: str
) -> Iterator[OtherCoil]:
    """Other coils of the setup than `name`, which is moved by `stage`."""
    for other, entry in coils.items():
        time, poses = seen_poses(session.topics.get(_TRACKER + other))
        if other == name or not time.size:
            continue
        place, travel = _place(setup, entry), None
        if place.stage != stage or not stage:
            stamps, travels = seen_travels(session.topics.get(place.stage))
            travel = np.zeros(time.size)
            if stamps.size:
                travel = np.interp(time, stamps, travels, left=np.nan, right=np.nan)
        yield OtherCoil(other, time, poses, place.arclength, travel, place.channel)


def _bodies(session: RawSession, setup: Table) -> tuple[dict[str, Body], TubeBody | None]:
    """Motion capture bodies on the robot, and the one on the sliding tube or None."""
    table = setup.table("bodies")
    known = table.names() if table else []
    out, tubes = {}, []
    for topic in session.topics.values():
        name = topic.name.removeprefix(_MOCAP)
        if not topic.name.startswith(_MOCAP):
            continue
        if table is None or name not in known:
            raise RecordingError(
                f"Motion capture saw {name!r}, and the setup does not say where it sits; add it to "
                f"its bodies with arclength, position and quaternion."
            )
        entry = table.subtable(name)
        time, poses = seen_poses(topic)
        if entry.flag("slides"):
            tubes.append(TubeBody(name, time, poses))
            for key in ("arclength", "position", "quaternion"):  # keys of bodies on the robot
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
