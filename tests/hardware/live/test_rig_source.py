"""However the process that reads a rig ends, the session learns of it and why."""

import os
import queue
import signal
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest

from glissando.errors import DeviceError, GlissandoError
from glissando.hardware.capture import Coil, FurtherStage, Rig
from glissando.hardware.drivers import GcodeStage
from glissando.hardware.live import rig_source
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.rig_source import RigSource
from glissando.io.robot_file import load_robot
from glissando.model.slide_path import SlideLimits, SlidePath
from waiting import until

RIG = Rig("bench", "sliding700")
HELD = SlidePath.hold(0.0, 3600.0, SlideLimits(1.0, 1.0, 1.0))


class Said(queue.Queue):
    """What is said, and what SIGTERM would do then."""

    def put(self, item):
        super().put((item, signal.getsignal(signal.SIGTERM)))


@pytest.mark.parametrize(
    ("problem", "sentence"),
    [
        (GlissandoError("The disk is full."), "The disk is full."),
        (OSError(28, "No space left"), r"cannot be read into .*No space left.*check the disk"),
        (ZeroDivisionError("oh"), r"has failed \(ZeroDivisionError"),
        (KeyboardInterrupt(), None),
    ],
)
def test_a_capture_that_fails_says_why_and_that_it_ends(monkeypatch, tmp_path, problem, sentence):
    def fail(*_, **__):
        raise problem

    monkeypatch.setattr(rig_source, "capture", fail)
    said, before = Said(), signal.getsignal(signal.SIGTERM)
    run = partial(rig_source._capture, RIG, (HELD, {}), tmp_path / "session", said, None)
    try:
        with suppress(ZeroDivisionError):
            run()
    finally:
        signal.signal(signal.SIGTERM, before)
    if sentence:
        end, handler = said.get_nowait()
        assert handler == signal.SIG_IGN
        with pytest.raises(DeviceError, match=sentence):
            raise end
    assert said.get_nowait() == (None, signal.SIG_IGN)


def test_a_rig_is_busy_until_each_of_its_stages_was_read():
    stage = GcodeStage(stroke=(0.0, 0.06), home=0.0)
    further = (FurtherStage("outer", "tcp://2", stage),)
    rig = replace(RIG, coils=(Coil("coil", 0.7),), slide="tcp://1", stage=stage, further=further)
    source, said = RigSource(rig, load_robot("sliding700"), HELD), queue.Queue()
    source._messages, source._process = said, SimpleNamespace(is_alive=lambda: True)
    moved = {"time": 0.0, "travel": 0.0}
    for item, problem in [
        (None, "rig bench is starting"),
        (("/tracker/coil", {"time": 0.0, "position": None}), "a stage of rig bench homes"),
        (("/slide", moved), "a stage of rig bench homes"),
        (("/slide/outer", moved), ""),
    ]:
        if item:
            said.put(item)
        assert source.read(SessionClock()) == []
        assert (source.problem, source.busy) == (problem, bool(problem))
    assert not RigSource(RIG, load_robot("sliding700"), HELD).busy


def test_a_process_that_dies_is_a_sentence_and_leaving_does_not_wait_for_it():
    source, clock = RigSource(RIG, load_robot("sliding700"), HELD), SessionClock()
    with source:
        os.kill(source._process.pid, signal.SIGKILL)

        def raised():
            try:
                source.read(clock)
            except DeviceError as problem:
                return str(problem)

        assert "bench has ended (exit status -9)" in until(raised)
        assert source.finished
        assert source.read(clock) == []
        source.finished, began = False, time.monotonic()
    assert time.monotonic() - began < 10.0
