"""The numbers of a robot file that can be learned: each is moved alone."""

import numpy as np
import pytest

from glissando import GlissandoError, load_robot
from glissando.calibration.robot.hyperparameters import Parameter, expanded, learnable, moved
from glissando.io.robot_file import parse_robot
from glissando.io.shipped_robots import shipped_robots
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.sensors.sensors import sensor_kinds
from glissando.model.table import Table
from learn_drawn import shipped


def parsed(document):
    return parse_robot(Table(document, "mine", GlissandoError))


@pytest.mark.parametrize("name", shipped_robots())
def test_writing_pairs_out_leaves_a_robot_as_it_was(name):
    given, written = load_robot(name), parsed(expanded(shipped(name)))
    for part, value in vars(given.prior).items():
        other = getattr(written.prior, part)
        if part == "base":
            value, other = list(vars(value).values()), list(vars(other).values())
        np.testing.assert_array_equal(value, other)
    for kind, std in given.sensor_std.items():
        np.testing.assert_array_equal(std, written.sensor_std[kind])
    for one, other in zip(given.sensor_parameters, written.sensor_parameters, strict=True):
        assert {k: str(v) for k, v in vars(one).items()} == {
            k: str(v) for k, v in vars(other).items()
        }


def test_two_numbers_of_a_sensor_of_two_rows_are_no_pair(monkeypatch):
    class Tilt(Readings):
        rows = 2

    monkeypatch.setitem(SENSORS, "tilt", Tilt)
    robot = {**shipped("tdcr466"), "sensors": {"tilt": {"std": [0.1, 0.2]}}}
    document = expanded(robot)
    assert parsed(document).sensor_std["tilt"].tolist() == [0.1, 0.2]
    (noise,) = (p for p in learnable(document, ["tilt"]) if "noise" in p.label)
    assert noise.entries == (0, 1)


@pytest.mark.parametrize("name", shipped_robots())
def test_every_learnable_number_of_a_shipped_robot_is_scaled_alone_and_parsed_again(name):
    document = expanded(shipped(name))
    numbers = learnable(document, sensor_kinds())
    assert len({p.label for p in numbers}) == len(numbers) > 5
    assert moved(document, numbers, np.zeros(len(numbers))) == document
    before = np.array([p.of(document) for p in numbers])
    for i in range(len(numbers)):
        x = np.zeros(len(numbers))
        x[i] = 0.7
        there = moved(document, numbers, x)
        after = np.array([p.of(there) for p in numbers])
        expected = before * np.exp(x)
        if numbers[i].unit is not None:
            expected[i] = before[i] + 0.7 * numbers[i].unit
        np.testing.assert_allclose(after, expected, rtol=1e-12)
        assert there != document
        parsed(there)


def test_a_factor_acts_on_the_named_entries_only():
    document = {"prior": {"psd": [1.0, 2.0, 3.0, 4.0], "scale": 5.0}, "other": [1.0]}
    some = Parameter("some", ("prior", "psd"), (1, 3))
    number = Parameter("number", ("prior", "scale"), ())
    assert some.of(document) == pytest.approx(np.sqrt(8.0))
    assert number.of(document) == pytest.approx(5.0)
    there = moved(document, [some, number], np.log([10.0, 2.0]))
    assert there["prior"]["psd"] == pytest.approx([1.0, 20.0, 3.0, 40.0])
    assert there["prior"]["scale"] == pytest.approx(10.0)
    assert there["other"] == [1.0]
    assert document["prior"]["psd"] == [1.0, 2.0, 3.0, 4.0]


def test_what_segments_have_each_is_scaled_together_where_they_are_alike():
    document = expanded(shipped("tdcr466-segments"))
    (number,) = (
        p
        for p in learnable(document, [], alike=True)
        if p.label.startswith("strain arclength") and p.label.endswith("bending")
    )
    rows = document["prior"]["psd_strain_arclength"]
    assert number.of(document) == pytest.approx(np.prod([r[3] * r[4] for r in rows]) ** 0.25)
    there = moved(document, [number], np.log([3.0]))["prior"]["psd_strain_arclength"]
    for row, was in zip(there, rows, strict=True):
        assert row == pytest.approx([*was[:3], 3.0 * was[3], 3.0 * was[4], was[5]])
    apart = [p.label for p in learnable(document, [])]
    together = [p.label for p in learnable(document, [], alike=True)]
    assert len(apart) - len(together) == 2


def test_a_number_that_is_zero_cannot_be_learned_and_is_left_out():
    document = expanded(shipped("tdcr466-segments"))
    before = len(learnable(document, []))
    document["prior"]["var_jumps"][0][5] = 0.0
    parsed(document)
    assert len(learnable(document, [])) == before - 1
