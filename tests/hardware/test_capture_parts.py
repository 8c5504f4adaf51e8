"""What an experiment gives its devices: times of a path, and names of coils."""

import sys
import threading
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from glissando.cli.record import slide_path
from glissando.errors import DeviceError
from glissando.hardware.capture import Coil, FurtherStage, Rig, capture
from glissando.hardware.capture.capture import _motion
from glissando.hardware.capture.coil_names import name_by_handle, name_by_identity
from glissando.hardware.capture.messages import Progress, log_tracker_frame
from glissando.hardware.drivers import PositionStage, SlideReading
from glissando.hardware.drivers.aurora_reply import Frame, PortReading
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.model.slide_path import SlideLimits, SlidePath

TOOLS = [Tool(10, "S1", "01", "00"), Tool(11, "S2", "02", "00")]


@pytest.mark.parametrize("duration", [36.300000000000004, 0.29, 0.004, 1.0])
def test_a_stage_is_given_times_that_increase_to_the_paths_end(duration):
    path = SlidePath.hold(0.0, duration, SlideLimits(1.0, 1.0, 1.0))
    stage = SimpleNamespace(follow=lambda times, travel: (times, travel))
    times, travel = _motion(stage, path, None)
    assert times[0] == 0.0
    assert times[-1] == path.duration
    steps = np.diff(times)
    assert 0.0 < steps.min() <= steps.max() < 0.01 + 1e-12
    assert travel.shape == times.shape


@pytest.mark.parametrize("order", [1, -1])
def test_a_coil_without_a_number_takes_a_plug_that_no_other_is_identified_by(order):
    coils = (Coil("free", 0.1), Coil("tip", 0.2, serial="S1"))[::order]
    assert name_by_handle(TOOLS, coils) == {10: "tip", 11: "free"}
    with pytest.raises(DeviceError, match="plug other in, or leave it out"):
        name_by_handle(TOOLS, (*coils, Coil("other", 0.3)))


def test_coils_that_do_not_describe_themselves_are_told_apart_by_their_handles():
    tools = [Tool(10, "", "", ""), Tool(11, "", "", ""), Tool(12, "S2", "02", "00")]
    names = name_by_identity(tools, {10: "one", 11: "two"})
    tracker, log = SimpleNamespace(tools=tools, counts={}), Logged()
    ports = tuple(PortReading(t.handle, "missing", 1, 0, None, 0.0) for t in tools)
    tracker.read = lambda patience: Frame(1, time.monotonic(), 0.0, time.monotonic(), ports)
    log_tracker_frame(tracker, names, log, 0.5)
    assert log.topics == ["/tracker/one", "/tracker/two"]


def test_coils_of_one_plug_and_no_serial_number_of_their_own_are_a_sentence():
    same = [Tool(10, "S1", "01", "00"), Tool(11, "S1", "01", "00")]
    with pytest.raises(DeviceError, match=r"Coil one states port 01, channel 00 and so does"):
        name_by_identity(same, {10: "one", 11: "two"})
    told = [Tool(10, "S1", "01", "00"), Tool(11, "S2", "01", "00")]
    assert name_by_identity(told, {10: "one", 11: "two"}) == {"S1": "one", "S2": "two"}


@pytest.mark.parametrize(("off", "side"), [(-1.8e9, "1.8e\\+09 s before"), (5.0, "5 s after")])
def test_a_tracker_whose_clock_is_another_is_a_sentence(off, side):
    log, now, frames = Logged(), time.monotonic(), []
    tracker = SimpleNamespace(tools=TOOLS, counts={}, read=lambda patience: frames.pop())

    def logged(stamp):
        ports = (PortReading(10, "valid", 1, 0, np.eye(4), 0.0),)
        frames.append(Frame(1, stamp, 0.0, now, ports))
        log_tracker_frame(tracker, {"S1": "tip"}, log, 0.5)

    with pytest.raises(DeviceError, match=f"Coil tip is stamped {side} its arrival; set both"):
        logged(now + off)
    logged(now - 0.1)
    logged(now - 1.5)  # it came late
    assert log.topics == 2 * ["/tracker/tip"]


def test_a_tracker_that_sends_nothing_is_named_until_it_does():
    log = Logged()
    frames = [Frame(1, 1.0, 0.0, 1.0, ()), None]
    tracker = SimpleNamespace(tools=TOOLS, counts={}, read=lambda patience: frames.pop())
    log_tracker_frame(tracker, {}, log, 0.5)
    assert log.progress.problems == {"tracker": "sent nothing for 0.5 s"}
    log_tracker_frame(tracker, {}, log, 0.5)
    assert log.progress.problems == {}


class Logged:
    """A log that keeps its topics."""

    def __init__(self):
        self.topics, self.progress = [], Progress()

    def write(self, topic, form, message, at, text):
        self.topics.append(topic)
        self.progress.last[topic] = text


class Homing:
    """A stage that homes until another thread aborts it; one without travel follows."""

    def __init__(self, homes):
        self.counts, self.homes, self.aborted = Counter(), homes, threading.Event()

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        STOOD.append(self.homes)

    def home_here(self, travel):
        pass

    def home_at_stop(self):
        assert self.aborted.wait(60.0)
        raise DeviceError("The motion of the stage was aborted.")

    def abort(self):
        self.aborted.set()

    def follow(self, times, travels):
        while True:
            time.sleep(0.01)
            yield SlideReading(time.monotonic(), 0.0, 0.0, 0.0, 0.0)


STOOD: list[bool] = []


def test_a_session_that_is_there_is_not_written_over(tmp_path):
    path = SlidePath.hold(0.0, 1.0, SlideLimits(1.0, 1.0, 1.0))
    with pytest.raises(DeviceError, match="exists; give a new folder for the session"):
        capture(Rig("bench", "sliding700"), path, tmp_path)


def test_an_interrupt_aborts_a_further_stage_that_homes(monkeypatch, tmp_path):
    module = sys.modules["glissando.hardware.capture.capture"]
    monkeypatch.setattr(module, "opened_stage", lambda address, stage: Homing(address == "b"))
    stage = PositionStage((0.0, 0.06), home=0.0)
    rig = Rig(
        "bench", "sliding700", slide="a", stage=stage, standing=0.0,
        further=(FurtherStage("two", "b", stage),),
    )  # fmt: skip
    path = SlidePath.hold(0.0, 60.0, SlideLimits(0.06, 0.024, 0.1))
    begun = time.monotonic()

    def interrupted(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        capture(rig, path, tmp_path / "session", on_progress=interrupted)
    assert time.monotonic() - begun < 10.0
    assert True in STOOD


def test_a_further_stage_that_is_aborted_while_it_is_opened_does_not_move(monkeypatch):
    class Opening(Homing):
        def __enter__(self):
            driven.abort()
            return self

        def home_at_stop(self):
            raise AssertionError("It homes.")

    module = sys.modules["glissando.hardware.capture.capture"]
    monkeypatch.setattr(module, "opened_stage", lambda address, stage: Opening(True))
    path = SlidePath.hold(0.0, 60.0, SlideLimits(0.06, 0.024, 0.1))
    stage = FurtherStage("two", "b", PositionStage((0.0, 0.06), home=0.0))
    driven = module._Driven(stage, path, None)
    with pytest.raises(StopIteration):
        driven()


@pytest.mark.parametrize("standing", [0.05, None])
def test_a_stage_that_holds_stays_where_it_stands(standing):
    options = SimpleNamespace(slide="hold", duration=5.0)
    stage = PositionStage((0.01, 0.06), home=0.0)
    further = FurtherStage("two", "b", stage, standing)
    rig = Rig("bench", "sliding700", slide="a", stage=stage, standing=standing, further=(further,))
    stands = 0.01 if standing is None else standing
    for one in (None, further):
        assert slide_path(options, rig, one).at(2.0) == stands
