"""Slide paths: they go where they say, and never break a stage's limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glissando.errors import SimulationError
from glissando.io.atomic import write_table
from glissando.simulation import SlideLimits, SlidePath, read_slide
from slide_paths import STAGE, finely, require_within

stages = st.builds(
    SlideLimits,
    stroke=st.floats(0.01, 1.0),
    speed=st.floats(0.001, 0.5),
    acceleration=st.floats(0.01, 5.0),
)
shares = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=6)


@settings(max_examples=60, deadline=None)
@given(stages, shares)
def test_moves_between_any_stops_keep_every_limit_and_reach_every_stop(stage, shares):
    stops = stage.stroke * np.array(shares)
    if np.ptp(stops) < 1e-4:
        return
    stops = np.append(stops[:1], stops[1:][np.abs(np.diff(stops)) > 1e-4])
    if stops.size < 2:
        return
    path = SlidePath.moves(stops, stage)
    require_within(path, stage)
    assert path.at(path.duration) == pytest.approx(stops[-1], abs=1e-9)
    at_rest = path.displacement[path.speed == 0.0]
    for stop in stops:
        assert np.abs(at_rest - stop).min() < 1e-9


@settings(max_examples=60, deadline=None)
@given(stages, st.integers(1, 5), st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_oscillations_return_as_often_as_asked_within_every_limit(stage, cycles, stroke, speed):
    path = SlidePath.oscillate(cycles, stroke * stage.stroke, stage, speed=speed * stage.speed)
    require_within(path, stage)
    turns = path.displacement[path.speed == 0.0]
    assert np.allclose(turns[::2], 0.0, atol=1e-9)
    assert np.allclose(turns[1::2], stroke * stage.stroke, atol=1e-9)
    assert turns[1::2].size == cycles


@settings(max_examples=40, deadline=None)
@given(stages, st.floats(1.0, 100.0), st.floats(0.1, 1.0))
def test_a_path_to_calibrate_by_rests_at_every_turn_and_lasts_as_long_as_asked(stage, lasts, share):
    path = SlidePath.calibrate(lasts, share * stage.stroke, stage)
    require_within(path, stage)
    assert path.duration == pytest.approx(lasts)
    at_rest = (path.speed[1:] == 0.0) & (path.speed[:-1] == 0.0)
    assert np.all(np.diff(path.time)[at_rest][:-1] > 0.5)


def test_a_path_to_calibrate_by_goes_all_over_the_stroke_and_turns_often():
    path = SlidePath.calibrate(45.0, 0.06, STAGE)
    assert (path.displacement.min(), path.displacement.max()) == pytest.approx((0.0, 0.06))
    ways = np.sign(np.diff(path.displacement[path.speed == 0.0]))
    assert np.sum(np.diff(ways[ways != 0.0]) != 0.0) > 12
    assert np.mean(path.speed_at(np.arange(0.0, 45.0, 0.01)) == 0.0) > 0.3


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.0, 0.06), min_size=2, max_size=5), st.floats(1.0, 3.0))
def test_waypoints_are_met_at_their_times_within_every_limit(places, slack):
    longest = np.abs(np.diff(places)).max() / STAGE.speed + STAGE.speed / STAGE.acceleration
    time = np.arange(len(places)) * (slack * longest + 0.5)
    path = SlidePath.waypoints(time, places, STAGE)
    require_within(path, STAGE)
    assert np.allclose(path.at(time), places, atol=1e-9)


def test_three_cycles_of_60_mm_at_24_mm_per_s_take_what_a_trapezoid_takes():
    path = SlidePath.oscillate(3, 0.06, STAGE, speed=0.024)
    assert path.duration == pytest.approx(6 * (0.06 / 0.024 + 0.024 / 0.1))


def test_the_stage_holds_before_and_after_its_path():
    path = SlidePath.moves([0.01, 0.05], STAGE)
    assert path.at([-1.0, 99.0]).tolist() == pytest.approx([0.01, 0.05])
    assert path.speed_at([-1.0, 99.0]).tolist() == [0.0, 0.0]


def test_a_path_written_and_read_is_the_same(tmp_path):
    path = SlidePath.oscillate(2, 0.05, STAGE)
    knots = np.column_stack([path.time, path.displacement, path.speed])
    write_table(tmp_path / "path.csv", ["time", "displacement", "speed"], knots)
    time, place = finely(path, 999)
    assert np.allclose(read_slide(tmp_path / "path.csv", STAGE).at(time), place, atol=1e-9)


def test_waypoints_are_read_from_a_file_without_speeds(tmp_path):
    (tmp_path / "path.csv").write_text("displacement,time\n0,0\n0.03,4\n0.01,8\n")
    assert read_slide(tmp_path / "path.csv", STAGE).at([4, 8]).tolist() == pytest.approx(
        [0.03, 0.01]
    )


def thrown(places, speed):
    return SlidePath([0, 1, 1.4, 2.4], places, [0, speed, -speed, 0], STAGE)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: SlidePath.oscillate(1, 0.08, STAGE), "stroke would be 0.08 m; the stage allows"),
        (lambda: SlidePath.oscillate(1, 0.05, STAGE, speed=0.03), "speed would be 0.03 m/s"),
        (lambda: SlidePath.oscillate(1, 0.05, STAGE, speed=0.0), "at 0 m/s cannot be"),
        (lambda: SlidePath.oscillate(0, 0.05, STAGE), "0 cycles cannot be"),
        (lambda: SlidePath.oscillate(1, -0.05, STAGE), "stroke of -0.05 m cannot be"),
        (lambda: SlidePath.calibrate(20.0, 0.08, STAGE), "stroke would be 0.08 m"),
        (lambda: SlidePath.hold(-0.01, 1.0, STAGE), "10 mm beyond the tip"),
        (lambda: SlidePath.hold(0.0, 0.0, STAGE), "slide of 0 s cannot be"),
        (lambda: SlidePath.waypoints([0, 1], [0, 0.05], STAGE), "takes 1.41 s. Give it more time"),
        (lambda: SlidePath.waypoints([0, 2], [0, 0.05], STAGE), "speed would be 0.02929 m/s"),
        (lambda: SlidePath.waypoints([1, 1], [0, 0], STAGE), "must be two or more, and increase"),
        (
            lambda: SlidePath([0, 1, 2], [0, 0, 0], [0, 0.02, 0], STAGE),
            "speeds and displacements differ by -10 mm",
        ),
        (
            lambda: SlidePath([0, 0.1, 0.2], [0, 0.001, 0.002], [0, 0.02, 0], STAGE),
            "acceleration would be 0.2 m/s²",
        ),
        (lambda: SlideLimits(0.06, -1.0, 0.1), "a speed of -1 m/s cannot be; give one above zero"),
        (lambda: SlideLimits(60.0, 0.024, 0.1), "60 mm are 0.06 m"),
        (lambda: SlidePath([0, 10], [0, 0.05], [0.005, 0.005], STAGE), "begin and end at rest"),
        # both knots lie inside the stroke, the way between them does not
        (lambda: thrown([0.05, 0.06, 0.06, 0.05], 0.02), "stroke would be 0"),
        (lambda: thrown([0.01, 0, 0, 0.01], -0.02), "2 mm beyond the tip"),
    ],
)
def test_an_impossible_slide_is_one_sentence(make, sentence):
    with pytest.raises(SimulationError) as caught:
        make()
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time,place\n0,0\n", "must have the columns time,displacement"),
        ("time,displacement\n0,0\n1,a\n", "row 2: give a number each"),
        ("time,displacement\n0,0\n", "must be two or more"),
    ],
)
def test_a_slide_file_that_cannot_be_is_one_sentence(tmp_path, text, sentence):
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(SimulationError, match=sentence):
        read_slide(tmp_path / "path.csv", STAGE)


def test_a_path_in_arclength_is_that_path_in_displacement(tmp_path):
    path = SlidePath.oscillate(2, 0.05, STAGE)
    table = np.column_stack([path.time, 0.7 - path.displacement, -path.speed])
    file = tmp_path / "path.csv"
    np.savetxt(file, table, "%.15g", ",", header="time,arclength,speed", comments="")
    read = read_slide(file, STAGE, drawn_out=0.7)
    np.testing.assert_allclose(read.at(path.time), path.displacement, atol=1e-12)
    np.savetxt(file, table[[0, -1], :2], "%.15g", ",", header="time,arclength", comments="")
    assert read_slide(file, STAGE, drawn_out=0.7).at(3.0) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(SimulationError, match="time,displacement"):
        read_slide(file, STAGE)
