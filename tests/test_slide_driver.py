"""The driver of the stage: it goes where it may, says what it did, and stops whatever happens."""

import os
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import law
from glissando.drivers import Slide, Stage
from glissando.drivers.dynamixel import WRAP, hardware_error, unwrapped
from glissando.errors import DeviceError
from glissando.simulate import SlideLimits, SlidePath
from glissando.simulate.devices import started
from glissando.simulate.devices.dynamixel import Do, packed
from glissando.simulate.devices.xl430 import OVERLOAD
from glissando.tables import Table
from servo_world import World, together

STAGE = Stage(lead=0.0254, stroke=(0.0, 0.06), home=-0.002)
TICK = STAGE.lead / 4096


def home(world, stage=STAGE):
    """An open slide that knows where it is; the world's true travel."""
    slide = Slide("world", stage).__enter__()
    slide.home_here(world.screw.travel)
    return slide


# What a stage is.


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"lead": 0.002}, "at 720 rpm; the servo does 60.7 rpm, 2.02 mm/s"),
        ({"lead": 0.0}, "lead of 0 m and a direction of 1 cannot be"),
        ({"direction": 2}, "direction of 2 cannot be"),
        ({"direction": 0.5}, "direction of 0.5 cannot be"),
        ({"stroke": (0.06, 0.0)}, "give a lower and a higher end"),
        ({"stroke": (0.0, 9.0)}, "at most 244 revolutions"),
        ({"home": 0.01}, "lies inside the stroke"),
        ({"speed": 0.026}, "26 mm/s would turn the screw"),
        ({"speed": 0.0}, "a speed of 0 m/s cannot be"),
        ({"speed": float("nan")}, "is no number"),
        ({"acceleration": 1e-5}, "acceleration of 1e-05 m/s² cannot be"),
        ({"watchdog": 3.0}, "give 0.02 to 2.54 s"),
        ({"id": 300}, "give 0 to 252"),
    ],
)
def test_a_stage_that_cannot_be_is_one_sentence(settings, sentence):
    with pytest.raises(DeviceError) as caught:
        replace(STAGE, **settings)
    assert sentence.lower() in str(caught.value).lower()


def test_a_stage_is_read_from_a_table(tmp_path):
    text = (
        "[slide]\nlead = 0.0254\nstroke = [0, 0.06]\ndirection = -1\nhome = -0.002\nhold = true\n"
    )
    (tmp_path / "bench.toml").write_text(text)
    assert Stage.load(tmp_path / "bench.toml") == replace(STAGE, direction=-1, hold=True)


def test_a_misspelt_key_of_a_stage_is_named():
    table = Table(tomllib.loads("lead = 0.0254\nstroke = [0, 0.06]\nhom = 0"), "bench", DeviceError)
    with pytest.raises(DeviceError, match="did you mean 'home'"):
        Stage.from_table(table)


def test_24_mm_a_second_is_56_7_rpm_of_an_inch_of_lead():
    assert STAGE.speed_units(0.024) == 248
    assert STAGE.speed_of(248) == pytest.approx(0.024, rel=2e-3)


stages = st.builds(
    Stage,
    lead=st.floats(0.024, 0.1),
    stroke=st.just((0.0, 0.06)),
    direction=st.sampled_from([1, -1]),
)


@law
@given(stages, st.floats(-1.0, 1.0), st.floats(1e-3, 0.024), st.floats(0.02, 5.0))
def test_units_of_the_servo_there_and_back_are_the_same(stage, travel, speed, acceleration):
    assert stage.travel(stage.ticks(travel)) == pytest.approx(travel, abs=1e-12)
    unit = abs(stage.speed_of(1.0))
    assert abs(stage.speed_of(stage.speed_units(speed))) == pytest.approx(speed, abs=unit)
    assert stage.acceleration_units(acceleration) >= 1


# The servo's clock.


@law
@given(
    st.integers(0, WRAP - 1),
    st.lists(st.tuples(st.integers(0, 600_000), st.floats(-15.9, 15.9)), min_size=1, max_size=20),
)
def test_ticks_unwrap_to_the_time_that_passed_however_long_and_however_roughly_known(first, steps):
    truth = told = first
    for step, error in steps:
        truth += step
        told = unwrapped(told, truth % WRAP, step / 1e3 + error)
        assert told == truth


def test_the_clock_of_the_readings_never_wraps():
    world = World()
    with together(world):
        slide = home(world)
        seen = [slide.read()]
        for wait in (1.0, 2.0, 40.0, 3.0, 200.0):
            world.passes(wait)
            seen.append(slide.read())
    host = np.diff([r.time for r in seen])
    assert np.diff([r.servo_time for r in seen]) == pytest.approx(host, abs=0.005)


def test_hardware_errors_have_words():
    assert "overloaded" in hardware_error(OVERLOAD)
    assert hardware_error(0x05).count("; ") == 2
    assert "unknown error 0x40" in hardware_error(0x40)


# Nothing moves before it may.


@pytest.mark.parametrize(
    "ask",
    [
        lambda slide: slide.move(0.01),
        lambda slide: list(slide.follow([0, 1], [0.03, 0.04])),
        lambda slide: slide.read(),
    ],
)
def test_nothing_moves_before_the_stage_is_home(ask):
    world = World()
    with together(world), Slide("world", STAGE) as slide:
        before = world.servo._actual(world.now)[0]
        with pytest.raises(DeviceError, match="does not know where it is"):
            ask(slide)
        world.passes(1.0)
        assert world.servo._actual(world.now)[0] == before
        assert not world.servo.table["torque_enable"]


def test_homing_where_it_stands_does_not_move_it():
    world = World()
    with together(world), Slide("world", STAGE) as slide:
        slide.home_here(0.03)
        world.passes(1.0)
        assert slide.read().travel == pytest.approx(0.03, abs=TICK)
    assert np.ptp([s for _, s in world.travel]) == 0.0


def test_a_stage_outside_a_with_block_is_one_sentence():
    with pytest.raises(DeviceError, match="use it as `with Slide"):
        Slide("world", STAGE).home_here(0.0)


@pytest.mark.parametrize("travel", [-1e-4, 0.0601, 1.0])
def test_a_travel_outside_the_stroke_is_refused(travel):
    world = World()
    with together(world):
        slide = home(world)
        for ask in (
            lambda: slide.move(travel),
            lambda: list(slide.follow([0, 99], [0.03, travel])),
            lambda: slide.home_here(travel),
        ):
            with pytest.raises(DeviceError, match="outside the stroke from 0 to 60 mm"):
                ask()
    assert np.ptp([s for _, s in world.travel]) == 0.0


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda s: s.move(0.04, speed=0.025), "25 mm/s is asked for; this stage allows 24 mm/s"),
        (lambda s: s.move(0.04, speed=0.03), "at 70.87 rpm; the servo does 60.7 rpm"),
        (lambda s: s.move(0.04, acceleration=1e9), "acceleration of 1e+09"),
        (lambda s: list(s.follow([0, 1], [0.01, 0.0349])), "24.9 mm/s is asked for"),
        (lambda s: list(s.follow([0, 0], [0.01, 0.01])), "must increase"),
        (lambda s: list(s.follow([0, 1], [0.01, np.nan])), "all its numbers be finite"),
        (lambda s: list(s.follow([0], [0.01])), "two or more of each"),
        (lambda s: list(s.follow([0, 1], [0, 0], rate=5.0)), "give a rate of 10 Hz"),
    ],
)
def test_what_the_stage_must_not_do_is_one_sentence(ask, sentence):
    world = World()
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError) as caught:
            ask(slide)
    assert sentence in str(caught.value)
    assert np.ptp([s for _, s in world.travel]) == 0.0


# Moving.


@pytest.mark.parametrize("direction", [1, -1])
def test_60_mm_at_24_mm_a_second_takes_what_its_trapezoid_takes(direction):
    world = World(start=0.0, direction=direction)
    with together(world):
        slide = home(world, replace(STAGE, direction=direction))
        readings = slide.move(0.06)
    moved = [t for (t, a), (_, b) in pairwise(world.travel) if a != b]
    assert moved[-1] - moved[0] == pytest.approx(2.5 + 0.24, rel=0.01)
    assert readings[-1].travel == pytest.approx(0.06, abs=TICK)
    assert max(r.speed for r in readings) == pytest.approx(0.024, rel=0.01)
    assert min(r.speed for r in readings) >= 0.0
    assert world.screw.travel == pytest.approx(0.06, abs=TICK)


def test_readings_are_true_at_their_stamps():
    world = World(start=0.0)
    with together(world):
        readings = home(world).move(0.06)
    time_, truth = np.array(world.travel).T
    for reading in readings:
        there = np.interp(reading.time, time_, truth)
        assert abs(reading.travel - there) < 0.024 * 0.0015 + 2 * TICK


def test_a_path_is_followed_to_its_end_within_half_a_millimetre():
    limits = SlideLimits(stroke=0.06, speed=0.024, acceleration=0.1)
    path = SlidePath.oscillate(3, 0.06, limits, speed=0.024)
    times = np.append(np.arange(0.0, path.duration, 0.01), path.duration)
    world = World(start=0.03)
    with together(world):
        readings = list(home(world).follow(times, path.at(times)))
    begun = readings[0].time
    off = [r.travel - path.at(r.time - begun) for r in readings]
    assert np.abs(off).max() < 5e-4
    assert readings[-1].travel == pytest.approx(0.0, abs=TICK)
    assert readings[-1].time - begun == pytest.approx(path.duration, abs=0.1)
    assert len(readings) == pytest.approx(50 * path.duration, rel=0.05)


def test_home_is_found_at_the_mechanical_stop():
    world = World(start=0.035, play=1e-4, ends=(-0.002, 0.062))
    with together(world), Slide("world", STAGE) as slide:
        slide.home_at_stop(speed=0.01)
        assert slide.homed
        assert world.servo.table["hardware_error"] == 0
        assert world.servo.table["goal_pwm"] == 885
        assert slide.read().travel == pytest.approx(0.0, abs=TICK)
        slide.move(0.05)
        assert world.screw.travel == pytest.approx(0.05, abs=1.1e-4)  # the play, and no more


def test_home_is_found_at_the_far_end_too():
    world = World(start=0.035, direction=-1)
    with together(world), Slide("w", replace(STAGE, direction=-1, home=0.062)) as slide:
        slide.home_at_stop(speed=0.01)
        assert world.screw.travel == pytest.approx(0.06, abs=2 * TICK)


def test_a_stop_that_is_not_there_is_missed_with_a_sentence():
    world = World(ends=(-1.0, 1.0))
    with together(world), Slide("w", STAGE) as slide:
        with pytest.raises(DeviceError, match="No stop was met"):
            slide.home_at_stop(speed=0.02)
        assert not slide.homed
    assert not world.servo.table["torque_enable"]


class Meddled(World):
    """A world in which somebody else switches the torque off after so many packets."""

    meddles = None

    def writePort(self, packet):  # noqa: N802
        if self.heard == self.meddles:
            self.servo.execute(Do.WRITE, bytes([64, 0, 0]), self.now)
        return super().writePort(packet)


def test_a_carriage_that_stands_without_pushing_is_not_at_its_stop():
    world = Meddled()
    world.meddles = 60
    with (
        together(world),
        Slide("w", STAGE) as slide,
        pytest.raises(DeviceError, match=r"No stop was met: .* with a load of 0 %"),
    ):
        slide.home_at_stop(speed=0.01)


def test_a_carriage_that_only_stuck_is_not_at_its_stop():
    """It can be pushed out to 20 mm, but not be brought back."""
    world = World(start=0.03)
    genuine = world.servo._actual

    def sticky(now):
        angle, speed = genuine(now)
        stuck = world.screw.angle - 4096 * 0.01 / 0.0254
        world.stuck = getattr(world, "stuck", False) or angle <= stuck
        return (stuck, 0.0) if world.stuck else (angle, speed)

    world.servo._actual = sticky
    with (
        together(world),
        Slide("w", STAGE) as slide,
        pytest.raises(DeviceError, match="stuck and does not come back with 25 %"),
    ):
        slide.home_at_stop(speed=0.01)


def test_a_stage_without_a_stop_says_so():
    world = World()
    with (
        together(world),
        Slide("w", replace(STAGE, home=None)) as slide,
        pytest.raises(DeviceError, match="say where it is with home_here"),
    ):
        slide.home_at_stop()


def test_a_blocked_carriage_is_stopped_and_told():
    world = World(ends=(-0.002, 0.04))
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError, match="off its path at 45"):
            list(slide.follow([0, 2], [0.03, 0.06]))
        place = world.servo._actual(world.now)[0]
        world.passes(3.0)
        assert world.servo._actual(world.now)[0] == pytest.approx(place, abs=1)
        with pytest.raises(DeviceError, match="stopped at 40 mm instead of 44 mm"):
            slide.move(0.044)


# Whatever is asked, the carriage stays inside.


inside_or_not = st.floats(-0.02, 0.08)
commands = st.one_of(
    st.tuples(st.just("move"), inside_or_not, st.floats(0.002, 0.03), st.floats(0.05, 2.0)),
    st.tuples(
        st.just("follow"), st.lists(inside_or_not, min_size=2, max_size=4), st.floats(0.3, 3.0)
    ),
    st.tuples(st.just("broken"), st.floats(0.0, 0.06), st.integers(1, 40)),
    st.tuples(st.just("interrupted"), inside_or_not, st.integers(1, 200)),
    st.tuples(st.just("stop")),
    st.tuples(st.just("wait"), st.floats(0.0, 3.0)),
)


class Interrupted(BaseException):
    """As KeyboardInterrupt, which would end the tests."""


def obey(slide, world, command):
    """One command; what the driver refuses or cannot do is part of the game."""
    kind, *rest = command
    try:
        if kind == "move":
            slide.move(rest[0], speed=rest[1], acceleration=rest[2])
        elif kind == "follow":
            list(slide.follow(np.linspace(0.0, rest[1], len(rest[0])), rest[0]))
        elif kind == "broken":
            for k, _ in enumerate(slide.follow([0.0, 3.0], [0.06 - rest[0], rest[0]])):
                if k == rest[1]:
                    break
        elif kind == "interrupted":
            world.fuse = world.heard + rest[1]
            slide.move(rest[0])
        elif kind == "stop":
            slide.stop()
        else:
            world.passes(rest[0])
    except (DeviceError, Interrupted):
        pass
    world.fuse = None


class Fused(World):
    """A world in which an interrupt may come at any byte."""

    fuse = None

    def readPort(self, length):  # noqa: N802
        if self.fuse is not None and self.heard >= self.fuse:
            self.fuse = None
            raise Interrupted
        return super().readPort(length)


@pytest.mark.slow
@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    st.lists(commands, min_size=2, max_size=6),
    st.sampled_from([1, -1]),
    st.sampled_from([(), ("corrupt=0.03", "short=0.03"), ("late=0.1:0.05",), ("dead=150",)]),
)
def test_no_commands_ever_take_the_carriage_outside_the_stroke(sequence, direction, faults):
    world = Fused(*faults, direction=direction, ends=(-0.05, 0.11))
    with together(world):
        try:
            with Slide("w", replace(STAGE, direction=direction)) as slide:
                slide.home_here(0.03)
                for command in sequence:
                    obey(slide, world, command)
        except DeviceError:
            assert faults
        world.passes(5.0)
    travel = np.array([place for _, place in world.travel])
    assert travel.min() >= -2 * TICK
    assert travel.max() <= 0.06 + 2 * TICK
    assert np.ptp(travel[-400:]) == 0.0  # and it stands in the end
    last = world.servo.table
    assert not last["torque_enable"] or last["bus_watchdog"] == -1 or faults == ("dead=150",)


# A line with faults.


def test_spoilt_answers_are_asked_for_again_and_counted():
    world = World("corrupt=0.05", "short=0.05", start=0.0)
    with together(world), Slide("w", replace(STAGE, watchdog=1.0)) as slide:
        slide.home_here(0.0)
        readings = slide.move(0.06)
    assert readings[-1].travel == pytest.approx(0.06, abs=TICK)
    assert slide.counts["corrupt"] > 5
    travels = [r.travel for r in readings]
    assert np.all(np.diff(travels) > -2 * TICK)


def test_a_late_answer_is_never_taken_for_a_new_one():
    """Late by more than the SDK waits: without care a reading would be 40 ms, 1 mm, too old."""
    world = World("late=0.2:0.04", start=0.0)
    with together(world), Slide("w", replace(STAGE, watchdog=1.0)) as slide:
        slide.home_here(0.0)
        readings = slide.move(0.06)
    time_, truth = np.array(world.travel).T
    off = [r.travel - np.interp(r.time, time_, truth) for r in readings]
    assert set(slide.counts) == {"missing"}  # late ones are waited for and thrown away
    assert slide.counts["missing"] > 5
    # The middle of an exchange of 34 ms at most is off by half of it.
    assert np.abs(off).max() < 0.024 * 0.018


def test_a_stale_answer_is_found_by_its_tick():
    world = World()
    with together(world):
        slide = home(world)
        read = packed(1, Do.READ, bytes([120, 0, 16, 0]))
        (old,) = world.stage._bus.receive(read, world.now)
        world.passes(0.1)
        say = world.stage.say
        answers = [b"", old]  # nothing when the line is cleared, then one from before
        world.stage.say = lambda now: answers.pop(0) if answers else say(now)
        slide.read()
    assert slide.counts["stale"] == 1


def moved_from_zero(world, stage=STAGE):
    """Home at 0 and move to 60 mm, in a block of its own."""
    with Slide("w", stage) as slide:
        slide.home_here(0.0)
        slide.move(0.06)


def test_loss_of_replies_ends_with_a_sentence_and_a_standstill():
    world = World("dead=120", start=0.0)
    with together(world):
        with pytest.raises(DeviceError, match="did not answer 4 times in a row at 57600 baud"):
            moved_from_zero(world)
        place = world.screw.travel
        assert 0.005 < place < 0.055
        world.passes(5.0)
    assert world.screw.travel == place
    assert world.servo.table["bus_watchdog"] == -1


def test_a_servo_that_hears_but_is_not_heard_is_switched_off_soon():
    world = World("silent=120:9999", start=0.0)
    with together(world):
        with pytest.raises(DeviceError, match="did not answer"):
            moved_from_zero(world)
        world.passes(5.0)
    assert not world.servo.table["torque_enable"]
    lost = next(t for t, number in world.told if number > 120)
    moved = [t for (t, a), (_, b) in pairwise(world.travel) if a != b]
    assert moved[-1] - lost < 0.3  # four attempts, and off


def test_a_torque_that_somebody_else_took_makes_the_place_doubtful():
    world = Meddled()
    with together(world):
        slide = home(world)
        world.meddles = world.heard
        with pytest.raises(DeviceError, match="has lost its torque"):
            slide.move(0.04)
        assert not slide.homed


def test_a_short_silence_is_survived():
    world = World("silent=120:2", start=0.0)
    with together(world), Slide("w", STAGE) as slide:
        slide.home_here(0.0)
        assert slide.move(0.06)[-1].travel == pytest.approx(0.06, abs=TICK)
    assert slide.counts == {"missing": 2}


def test_an_overload_is_told_in_words_and_a_reboot_and_home_mend_it():
    world = World("overload=120", start=0.0)
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError, match="it was overloaded; free the carriage"):
            slide.move(0.06)
        slide.reboot()
        assert not slide.homed
        with pytest.raises(DeviceError, match="does not know where it is"):
            slide.move(0.03)
        slide.home_here(world.screw.travel)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


@pytest.mark.parametrize("at", [20, 60, 120, 200])
def test_a_loss_of_power_is_noticed_and_the_place_is_not_believed_any_more(at):
    world = World(f"restart={at}", start=0.01)
    with together(world):
        slide = home(world)
        with pytest.raises(DeviceError, match=r"lost power|lost its torque|did not answer"):
            _ = [slide.move(travel) for travel in (0.02, 0.05, 0.02, 0.05)]
        world.passes(1.0)
        with pytest.raises(DeviceError, match=r"lost power|does not know"):
            slide.read()
        slide.home_here(world.screw.travel)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


def test_a_loop_that_dawdles_is_stopped_by_the_watchdog_and_told():
    world = World()
    with together(world):
        slide = home(world)
        path = slide.follow([0, 2], [0.03, 0.06])
        with pytest.raises(DeviceError, match=r"heard nothing for 0.2 s while it moved"):
            _ = [world.passes(0.5 if reading.travel > 0.04 else 0.0) for reading in path]
        assert world.screw.travel == pytest.approx(0.0415, abs=2e-3)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


# Every way out stops the motion.


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("end", [RuntimeError, Interrupted, SystemExit, None])
def test_every_way_out_of_the_block_stops_the_motion(end, hold):
    world = World(start=0.0)
    with together(world):
        try:
            with Slide("w", replace(STAGE, hold=hold)) as slide:
                slide.home_here(0.0)
                for reading in slide.follow([0, 3], [0.0, 0.06]):
                    if reading.travel > 0.02:
                        if end is None:
                            break
                        raise end
        except (RuntimeError, Interrupted, SystemExit):
            pass
        place = world.screw.travel
        world.passes(3.0)
    assert world.screw.travel == pytest.approx(place, abs=TICK)
    assert place < 0.022
    assert world.servo.table["torque_enable"] == hold
    assert world.servo.table["bus_watchdog"] == 0


@pytest.mark.parametrize("way", ["break", "interrupt"])
def test_a_motion_that_is_broken_off_ends_there_while_the_block_goes_on(way):
    world = Fused(start=0.0)
    with together(world):
        slide = home(world)
        if way == "break":
            for reading in slide.follow([0, 3], [0.0, 0.06]):
                if reading.travel > 0.02:
                    break
        else:
            world.fuse = world.heard + 80
            with pytest.raises(Interrupted):
                slide.move(0.06)
        place = world.screw.travel
        world.passes(3.0)
        assert 0.0 < place < 0.05
        assert world.screw.travel == pytest.approx(place, abs=TICK)
        assert slide.move(0.03)[-1].travel == pytest.approx(0.03, abs=TICK)


@pytest.mark.parametrize("bytes_read", range(130, 170, 7))
def test_an_interrupt_inside_the_sdk_stops_the_motion(bytes_read):
    world = Fused(start=0.0)
    with together(world):
        world.fuse = bytes_read
        with pytest.raises(Interrupted):
            moved_from_zero(world)
        place = world.screw.travel
        world.passes(3.0)
    assert world.screw.travel == pytest.approx(place, abs=TICK)
    assert place < 0.055
    assert not world.servo.table["torque_enable"]


def test_settings_of_the_eeprom_are_put_right_once_and_then_left_alone():
    world = World()
    world.servo.table["homing_offset"] = 500
    world.servo.table["drive_mode"] = 5
    with together(world):
        with Slide("w", STAGE):
            pass
        names = ("operating_mode", "homing_offset", "drive_mode")
        assert [world.servo.table[name] for name in names] == [4, 0, 0]
        before = world.heard
        with Slide("w", STAGE):
            pass
        assert world.heard - before == 1 + 2 + 3 + 1 + 1 + 1 + 1


def test_another_model_is_refused():
    world = World()
    world.servo.table["model"] = 1020
    with together(world), pytest.raises(DeviceError, match="is of model 1020"):
        Slide("w", STAGE).__enter__()


# In life: another process, its clock, and signals.


class Ear:
    """Listens to the stage's true travel."""

    def __init__(self):
        self.told = []  # (time, travel)
        self._news = threading.Condition()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while len(data := self._socket.recv(64)) == 16:
            with self._news:
                self.told.append(struct.unpack("<dd", data))
                self._news.notify()

    def after(self, time_):
        """What was told of the time since, once the last half second saw no motion; bounded."""
        end = time.monotonic() + 20.0
        while time.monotonic() < end:
            with self._news:
                self._news.wait(1.0)
                told = np.array([one for one in self.told if one[0] >= time_]).reshape(-1, 2)
            if len(told) > 100 and np.ptp(told[-100:, 1]) == 0.0:
                return told
        raise AssertionError("the stage still moves")

    def close(self):
        host, _, port = self.address.partition(":")
        self._socket.sendto(b"", (host, int(port)))
        self._thread.join(10.0)
        self._socket.close()


@pytest.fixture
def ear():
    heard = Ear()
    yield heard
    heard.close()


def simulated(ear, *more):
    return started("servo", "--travel", ear.address, "--backlash", "0", *more)


PROGRAM = """
    import sys
    from glissando.drivers import Slide, Stage

    stage = Stage(lead=0.0254, stroke=(0.0, 0.06), speed=0.01, watchdog=0.5)
    with Slide(sys.argv[1], stage) as slide:
        slide.home_here(0.0)
        for reading in slide.follow([0, 6], [0.0, 0.06]):
            if reading.travel > 0.005:
                print("moving", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_host_that_is_interrupted_or_killed_leaves_the_stage_standing(ear, number):
    from dynamixel_sdk import PacketHandler, PortHandler

    with simulated(ear) as address:
        command = [sys.executable, "-c", textwrap.dedent(PROGRAM), address]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=subprocess.DEVNULL, text=True) as host:
            assert host.stdout.readline() == "moving\n"
            os.kill(host.pid, number)
            host.wait(10.0)
            host.stdout.close()
        told = ear.after(time.monotonic())
        assert 0.005 < told[-1, 1] < 0.05
        port, handler = PortHandler(address), PacketHandler(2.0)
        assert port.setBaudRate(57600)
        torque, watchdog = (_sound(handler, port, at) for at in (64, 98))
        port.closePort()
    assert (torque, watchdog) == ((0, 0) if number == signal.SIGINT else (1, 255))


def _sound(handler, port, at):
    for _ in range(10):
        value, result, _ = handler.read1ByteTxRx(port, 1, at)
        if result == 0:
            return value
    raise AssertionError(result)


def test_in_life_a_move_takes_its_time_and_readings_are_true_at_their_stamps(ear):
    with simulated(ear, "--clock", "1.002", "--seed", "7") as address:
        with Slide(address, replace(STAGE, watchdog=1.0)) as slide:
            slide.home_here(0.0)
            readings = slide.move(0.06)
        told = ear.after(0.0)
    moving = told[1:][np.diff(told[:, 1]) != 0.0, 0]
    assert moving[-1] - moving[0] == pytest.approx(2.5 + 0.24, abs=0.03)
    off = np.array([r.travel - np.interp(r.time, *told.T) for r in readings])
    assert np.median(np.abs(off)) < 3e-5
    clock = np.diff([(r.time, r.servo_time) for r in (readings[0], readings[-1])], axis=0)[0]
    assert clock[1] / clock[0] == pytest.approx(1.002, abs=0.01)
    print(f"{len(readings)} readings, off by {1e6 * np.abs(off).max():.0f} um at most")


def test_a_port_that_is_not_there_is_one_sentence():
    with pytest.raises(DeviceError, match="cannot be opened"):
        Slide("/dev/no_such_port", STAGE).__enter__()


def test_a_port_that_goes_away_is_one_sentence():
    with started("servo") as address:
        slide = Slide(address, STAGE).__enter__()
        slide.home_here(0.0)
    with pytest.raises(DeviceError, match=r"is gone|did not answer"):
        slide.read()
    with pytest.raises(DeviceError):
        slide.__exit__(None, None, None)
