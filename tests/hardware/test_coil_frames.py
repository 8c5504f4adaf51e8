"""A rig's coils are where its slides were at each frame, or nowhere while nobody knows."""

import json
from dataclasses import replace

import numpy as np
import pytest

from glissando.hardware.capture import Coil, FurtherStage, Rig
from glissando.hardware.capture.coil_frames import CoilFrames
from glissando.hardware.drivers import GcodeStage
from glissando.io.robot_file import load_robot
from glissando.io.session_log import SessionWriter, read_session
from glissando.io.session_recording import session_streams
from glissando.model.noise import Huber

ROBOT = load_robot("sliding700")
RIG = Rig(
    "bench", "sliding700", coils=(Coil("coil", 0.7), Coil("base", 0.0, slides=False)),
    slide="tcp://1", stage=GcodeStage(stroke=(0.0, 0.06)), standing=0.0,
)  # fmt: skip
SEEN = {"position": [0.0, 0.0, 0.7], "quaternion": [1.0, 0.0, 0.0, 0.0]}


def frame(frames, name, time):
    return list(frames.take(f"/tracker/{name}", {"time": time, **SEEN}))


def test_a_coil_is_where_its_slide_was_and_not_where_it_stands_by_now():
    loss = Huber(2.0)
    frames = CoilFrames(RIG, replace(ROBOT, sensor_loss={"coil": loss}))
    assert not frame(frames, "coil", 1.0)  # nobody has said where the slide is
    assert frames.counts["no travel"] == 1
    (base,) = frame(frames, "base", 1.0)
    assert (base.arclength[0], float(base.slide_speed)) == (0.0, 0.0)
    for time, travel in ((2.0, 0.010), (2.1, 0.012), (2.2, 0.014)):
        assert not list(frames.take("/slide", {"time": time, "travel": travel}))
    (coil,) = frame(frames, "coil", 2.15)
    assert coil.arclength[0] == pytest.approx(0.7 - 0.013)
    assert float(coil.slide_speed) == pytest.approx(-0.02)
    assert float(coil.slide_way) == -1.0
    assert coil.loss == loss
    (coil,) = frame(frames, "coil", 2.25)  # the slide has not been read since
    assert coil.arclength[0] == pytest.approx(0.7 - 0.015)
    assert not list(frames.take("/tracker/coil", {"time": 2.3, "position": None}))
    assert frames.counts["not seen"] == 1


def test_without_a_stage_a_coil_stays_where_the_setup_says():
    frames = CoilFrames(replace(RIG, slide=None, stage=None), ROBOT)
    (coil,) = frame(frames, "coil", 1.0)
    np.testing.assert_allclose(coil.arclength, 0.7)


def test_a_recording_has_no_frames_from_before_or_after_the_stage_that_moves_the_coil(tmp_path):
    coils = Coil("coil", 0.7), Coil("outer", 0.5, slide="outer")
    stage = GcodeStage(stroke=(0.0, 0.06), home=0.0)
    rig = replace(RIG, coils=coils, further=(FurtherStage("outer", "tcp://2", stage),))
    times = np.arange(0.0, 10.05, 0.1)
    travels = np.interp(times, [4.0, 9.0], [0.0, 0.05])
    frames = CoilFrames(rig, ROBOT)
    with SessionWriter(tmp_path / "log.mcap", {"setup": json.dumps(rig.described())}) as log:
        topics = "/slide", "/slide/outer", "/tracker/coil", "/tracker/outer"
        for topic in topics:
            log.add_topic(topic, {"type": "object"})
        placed = {"coil": [], "outer": []}
        for number, (time, travel) in enumerate(zip(times, travels, strict=True)):
            for topic in topics:
                if topic == "/slide/outer" and not 4.0 <= time <= 9.0:  # it homes, or is over
                    continue
                message = {"time": time, "frame": number, "travel": travel, **SEEN}
                log.write(topic, message, round(1e9 * time))
                for reading in frames.take(topic, message):
                    placed[reading.name].append((reading.time[0], reading.arclength[0]))
    streams = session_streams(read_session(tmp_path / "log.mcap"), rig.described()).streams
    assert [stream.name for stream in streams] == ["coil", "outer"]
    for stream, ends in zip(streams, ((times[0], times[-1]), (4.0, 9.0)), strict=True):
        rows, (time, arclength) = stream.rows, np.transpose(placed[stream.name])
        np.testing.assert_allclose([rows.time[0], rows.time[-1]], ends)
        np.testing.assert_allclose(rows.arclength, arclength[time <= ends[1] + 1e-9])
