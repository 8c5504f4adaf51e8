"""A stage that another program drives goes where it is asked, and stands when that falls silent."""

import os
import time
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.capture import Rig, capture, load_rig
from glissando.hardware.capture.devices import opened_stage
from glissando.hardware.drivers import RemoteStage, remote_stage
from glissando.hardware.drivers.remote_stage import RemoteSlide
from glissando.io.session_log import read_session
from glissando.model.slide_path import SlideLimits, SlidePath
from stage_peers import Carriage, driving

pytestmark = [
    pytest.mark.alone,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of rclpy's own imports
]
STAGE = RemoteStage(stroke=(0.0, 0.06), speed=0.1, direction=-1, joint="slide")


@pytest.fixture(params=["igtl", "ros2"])
def wire(request):
    if request.param == "ros2":
        reason = "rclpy is not installed; pip install 'glissando[ros2]' has wheels for Python 3.11"
        pytest.importorskip("rclpy", reason=reason)
        return f"ros2?domain={100 + os.getpid() % 100}"
    return "igtl"


@pytest.mark.slow
def test_ten_drawn_moves_end_where_they_were_to_and_ask_for_nothing_outside_the_stroke(wire):
    carriage, travels = Carriage(), np.random.default_rng(7).uniform(0.0, 0.06, 10)
    zero = carriage.place + 0.02
    with driving(wire, carriage) as address, opened_stage(address, STAGE) as slide:
        with pytest.raises(DeviceError, match="Home it first"):
            slide.move(0.01)
        slide.home_here(0.02)
        for travel in travels:
            assert slide.move(float(travel))[-1].travel == pytest.approx(travel, abs=5e-4)
            assert carriage.place == pytest.approx(zero - travel, abs=5e-4)
        for wanted in (lambda t: -0.001, lambda t: 0.061, lambda t: np.nan):
            with pytest.raises(DeviceError, match="outside the stroke"):
                list(slide.pursue(wanted, 1.0))
    assert len(carriage.goals) >= 10
    assert zero - 0.06 - 1e-6 <= min(carriage.goals) <= max(carriage.goals) <= zero + 1e-6


class Told:
    """A peer whose positions are told beforehand: (s, m), a list for each time it is asked."""

    def __init__(self, *told):
        self.told, self.counts, self.problem = list(told), Counter(), ""

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        pass

    def positions(self):
        return self.told.pop(0) if self.told else []

    def send(self, place, speed):
        pass


@pytest.mark.parametrize(("pause", "sound"), [(0.5, True), (0.0, False)])
def test_positions_that_a_stall_held_back_are_no_disturbance_and_a_jump_is(pause, sound):
    """Both positions after the pause come at once; the first was measured when it began."""
    late, way = 0.04 + pause, 0.01  # m in 0.5 s at 0.02 m/s, or in no time
    still = [[(at, 0.02)] for at in (0.0, 0.01, 0.02)]
    peer = Told(*still, [(late, 0.0204)], [(late + 1e-3, 0.0204 + way)])
    stage = RemoteStage(stroke=(0.0, 0.06), speed=0.02, home=0.0, silence=0.05)
    with RemoteSlide(stage, peer) as slide:
        slide.home_here(0.02)
        slide.read()
        if sound:
            assert slide.read().travel == pytest.approx(0.0204 + way)
            return
        with pytest.raises(DeviceError):
            slide.read()
        assert slide.counts["corrupt"] == 1


class FirstLost(list):
    """Goals of which the first does not arrive."""

    lost = False

    def append(self, goal):
        if self.lost:
            super().append(goal)
        self.lost = True


@pytest.mark.slow
def test_a_goal_that_is_lost_is_sent_again():
    carriage = Carriage()
    carriage.goals = FirstLost()
    with driving("igtl", carriage) as address, opened_stage(address, STAGE) as slide:
        slide.home_here(0.02)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=5e-4)
    assert len(carriage.goals) < 8  # nothing is repeated while it goes


@pytest.mark.slow
def test_a_path_is_followed_and_left_in_its_midst_where_the_stage_is(wire):
    carriage, begun = Carriage(), []
    stage = RemoteStage(stroke=(-0.1, 0.2), home=0.0, speed=0.1, joint="slide")
    with driving(wire, carriage) as address, opened_stage(address, stage) as slide:
        slide.home_at_stop()  # it has homed itself: its positions are travels
        times = np.linspace(0.0, 1.5, 50)
        for reading in slide.follow(times, carriage.place + 0.04 * times):
            begun.append(reading)
            if reading.time - begun[0].time > 0.7:
                break
        slide.stop()
        assert slide.read().travel == pytest.approx(carriage.place, abs=1e-4)
        assert 0.11 < carriage.place < 0.145
    assert len(begun) > 15
    assert np.median([r.speed for r in begun[5:]]) == pytest.approx(0.04, abs=0.01)


@pytest.mark.parametrize(
    "says", [None, *(pytest.param(x, marks=pytest.mark.slow) for x in (float("nan"), 140.0))]
)
def test_positions_that_end_or_make_no_sense_stop_the_stage_with_a_sentence(wire, says):
    carriage = Carriage()
    with driving(wire, carriage) as address:
        begun = 0.0

        def pursue():
            nonlocal begun
            with opened_stage(address, STAGE) as slide:
                slide.home_here(0.0)
                for reading in slide.pursue(lambda t: 0.02 * t, 2.5):
                    if reading.travel > 0.01 and not begun:
                        carriage.says, begun = lambda place: says, time.monotonic()

        with pytest.raises(DeviceError, match=r"has not stated where it is.*home again"):
            pursue()
        assert time.monotonic() - begun < 1.5
        time.sleep(0.3)
        assert carriage.place == carriage.goals[-1]  # it was told to hold
    assert 0.1 - carriage.place < 0.03


@pytest.mark.slow
def test_a_stage_that_is_held_is_stopped_and_one_that_jumps_is_not_believed(wire):
    carriage = Carriage()
    with driving(wire, carriage) as address, opened_stage(address, STAGE) as slide:
        slide.home_here(0.0)
        carriage.speed = 0.001
        with pytest.raises(DeviceError, match="off its path"):
            list(slide.pursue(lambda t: min(0.05 * t, 0.05), 2.0))
        carriage.says = lambda place: place + 0.02
        with pytest.raises(DeviceError, match="cannot have gone"):
            slide.read()
        with pytest.raises(DeviceError, match="Home it first"):
            slide.read()


@pytest.mark.slow
def test_a_driver_that_is_not_there_is_a_sentence(wire, monkeypatch):
    monkeypatch.setattr(remote_stage, "_FIRST", 0.5)
    carriage = Carriage()
    carriage.says = lambda place: None
    with driving(wire, carriage) as address, pytest.raises(DeviceError, match="none came"):
        opened_stage(address, STAGE).__enter__()
    alone = "igtl://127.0.0.1:9" if wire == "igtl" else wire
    with pytest.raises(DeviceError, match="nobody"):
        opened_stage(alone, STAGE).__enter__()


@pytest.mark.slow
def test_a_driver_whose_link_dies_on_the_way_is_a_sentence():
    with pytest.raises(DeviceError, match=r"nobody answers at igtl://.*home again"):
        _killed_on_the_way()


def _killed_on_the_way():
    driver = driving("igtl", Carriage())
    address = driver.__enter__()
    with opened_stage(address, replace(STAGE, silence=1.0)) as slide:
        slide.home_here(0.0)
        for k, _ in enumerate(slide.pursue(lambda t: 0.02 * t, 2.0)):
            if k == 10:
                driver.__exit__(None, None, None)


@pytest.mark.slow
def test_a_setup_file_names_a_stage_that_a_rig_records(wire, tmp_path):
    carriage = Carriage(place=0.0)
    with driving(wire, carriage) as address:
        (tmp_path / "bench.toml").write_text(f"""
robot = "sliding700"
[mocap]
port = 51077
[slide]
address = "{address}"
stroke = [0.0, 0.06]
home = 0.0
joint = "slide"
silence = 0.5
""")
        rig = load_rig(tmp_path / "bench.toml")
        assert rig.stage == RemoteStage((0.0, 0.06), home=0.0, joint="slide", silence=0.5)
        rig = Rig("bench", rig.robot, slide=rig.slide, stage=rig.stage)
        path = SlidePath.oscillate(1, 0.01, SlideLimits(0.06, 0.024, 0.1))
        capture(rig, path, tmp_path / "session")
    slid = read_session(tmp_path / "session" / "session.mcap").topics["/slide"].column("travel")
    assert slid.size > 20
    assert slid.max() == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize(
    "wrong", [{"silence": 0.0}, {"message": "twist"}, {"stroke": (0.0, 60.0)}, {"direction": 0}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(DeviceError):
        RemoteStage(**{"stroke": (0.0, 0.06), **wrong})


@pytest.mark.slow
@pytest.mark.parametrize("wire", ["ros2"], indirect=True)
def test_a_driver_that_does_not_know_of_the_goals_yet_is_waited_for(wire, monkeypatch):
    with driving(wire, Carriage(deaf=0.6)) as address, opened_stage(address, STAGE) as slide:
        slide.home_here(0.0)
        readings = list(slide.pursue(lambda t: 0.02 * t, 0.6))
    assert readings[-1].travel == pytest.approx(0.012, abs=5e-4)
    monkeypatch.setattr(remote_stage, "_FIRST", 0.5)
    with (
        driving(wire, Carriage(deaf=60.0)) as address,
        pytest.raises(DeviceError, match=r"no goal reaches it.*nobody hears /stage/servo_jp"),
    ):
        opened_stage(address, STAGE).__enter__()
