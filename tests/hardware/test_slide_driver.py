"""The driver moves the stage: truly, to its end, and never out of its stroke."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glissando.errors import DeviceError
from glissando.hardware.drivers import Slide
from glissando.simulation import SlideLimits, SlidePath
from servo_world import World, together
from slide_world import STAGE, TICK, Fused, Interrupted, Meddled, home


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


def test_a_path_that_changes_on_the_way_is_pursued_and_a_goal_outside_the_stroke_stops_it():
    world = World(start=0.01)

    def wanted(into):  # a plan, and from the third second on another
        return 0.01 + 0.01 * min(into, 3.0) - 0.005 * max(into - 3.0, 0.0)

    with together(world):
        slide = home(world)
        readings = list(slide.pursue(wanted, 4.0))
        begun = readings[0].time
        off = [r.travel - wanted(r.time - begun) for r in readings[:-1]]
        assert np.abs(off).max() < 1e-3
        with pytest.raises(DeviceError, match="outside the stroke"):
            list(slide.pursue(lambda into: 0.035 + 0.01 * into, 9.0))
        here = world.screw.travel
        assert slide.read().speed == 0.0
        assert slide.read().travel == pytest.approx(here, abs=2 * TICK)
    assert here < 0.0605


def test_home_is_found_at_the_mechanical_stop_at_either_end():
    world = World(start=0.035, direction=-1)
    with together(world), Slide("w", replace(STAGE, direction=-1, home=0.062)) as slide:
        slide.home_at_stop(speed=0.01)
        assert world.screw.travel == pytest.approx(0.06, abs=2 * TICK)
    world = World(start=0.035, play=1e-4, ends=(-0.002, 0.062))
    with together(world), Slide("world", STAGE) as slide:
        slide.home_at_stop(speed=0.01)
        assert slide.homed
        assert world.servo.table["hardware_error"] == 0
        assert world.servo.table["goal_pwm"] == 885
        assert slide.read().travel == pytest.approx(0.0, abs=TICK)
        slide.move(0.05)
        assert world.screw.travel == pytest.approx(0.05, abs=1.1e-4)  # the play, and no more


def test_a_stop_that_is_missed_or_not_configured_is_a_sentence():
    world = World(ends=(-1.0, 1.0))
    with together(world), Slide("w", STAGE) as slide:
        with pytest.raises(DeviceError, match="No stop was met"):
            slide.home_at_stop(speed=0.02)
        assert not slide.homed
    assert not world.servo.table["torque_enable"]
    unknown = pytest.raises(DeviceError, match="say where it is with home_here")
    with together(world), Slide("w", replace(STAGE, home=None)) as slide, unknown:
        slide.home_at_stop()


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


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
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
