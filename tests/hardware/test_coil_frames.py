"""A rig's coils are where its slides were at each frame, or nowhere while nobody knows."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.hardware.capture import Coil, Rig
from glissando.hardware.capture.coil_frames import CoilFrames
from glissando.hardware.drivers import GcodeStage
from glissando.io.robot_file import load_robot
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
