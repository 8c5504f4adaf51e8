"""Before anything moves: what a stage is, its units, its clock, and what it refuses."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import law
from glissando.errors import DeviceError
from glissando.hardware.drivers import Slide, Stage
from glissando.hardware.drivers.dynamixel import WRAP, hardware_error, unwrapped
from glissando.hardware.simulated_devices.xl430 import OVERLOAD
from glissando.model.table import Table
from servo_world import World, together
from slide_world import STAGE, TICK, home


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"lead": 0.002}, "at 720 rpm; the servo does 60.7 rpm, 2.02 mm/s"),
        ({"lead": 0.0}, "lead of 0 m cannot be"),
        ({"direction": 2}, "direction of 2 cannot be"),
        ({"direction": 0.5}, "direction of 0.5 cannot be"),
        ({"stroke": (0.06, 0.0)}, "give a lower and a higher end"),
        ({"lead": 0.002, "stroke": (0.0, 0.6)}, "at most 244 revolutions"),
        ({"home": 0.01}, "lies inside the stroke"),
        ({"lag": 5.0}, "5 m from its path at most, is not a laboratory's stage"),
        ({"speed": 0.026}, "26 mm/s would turn the screw"),
        ({"speed": 0.0}, "give speed, acceleration and lag above zero"),
        ({"speed": float("nan")}, "is not a number"),
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
    assert STAGE.speed_units(0.024) == 248  # 56.7 rpm of an inch of lead


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


def test_another_model_and_a_slide_outside_a_with_block_are_refused():
    world = World()
    world.servo.table["model"] = 1020
    with together(world), pytest.raises(DeviceError, match="is of model 1020"):
        Slide("w", STAGE).__enter__()
    with pytest.raises(DeviceError, match="use it as `with Slide"):
        Slide("w", STAGE).home_here(0.0)
