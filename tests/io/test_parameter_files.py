"""Sensor parameters that make no sense, and those of robot files."""

import numpy as np
import pytest

from glissando import estimate, load_robot
from glissando.errors import RobotFileError, SensorError
from glissando.io.shipped_robots import robot_file
from glissando.model.sensors.parameters import SensorParameter
from scenes import sliding_scene
from unknown_scenes import unknown

KINDS = "frame, mount, bias, arclength_offset, time_offset"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"kind": "colour"}, f"is a 'colour'; choose one of {KINDS}"),
        ({"value": np.zeros(2)}, "value is .* give 3 numbers"),
        ({"std": np.zeros(6)}, "std is .* give 3 numbers"),
        ({"std": 0.1}, "std is .* give 3 numbers"),
        ({"value": np.full(3, np.nan)}, "value is .* give 3 numbers"),
        ({"std": np.r_[0.1, -0.1, 0.1]}, "must not be negative"),
        ({"correlation_time": -1.0}, "must not be negative"),
        ({"correlation_time": 0.0}, "correlation time"),
        ({"correlation_time": np.nan}, "correlation time"),
    ],
)
def test_a_sensor_parameter_that_makes_no_sense_is_one_sentence(changes, sentence):
    right = {"kind": "bias", "streams": ("gyro",), "value": np.zeros(3), "std": np.full(3, 0.1)}
    SensorParameter("mine", **right)
    with pytest.raises(SensorError, match=sentence) as caught:
        SensorParameter("mine", **{**right, **changes})
    assert str(caught.value).startswith("Sensor parameter 'mine'")


@pytest.mark.parametrize("std", [0.0, 0.1])
def test_a_bias_of_a_pose_is_refused_and_named(std):
    rods, grid, readings = sliding_scene(nodes=3, rate=5.0)
    bias = unknown("bias", "coil", value=np.full(3, 0.1), std=std)
    with pytest.raises(SensorError, match="Sensor parameter 'bias': a CoilReadings has no bias"):
        estimate(rods, grid, readings, sensor_parameters=[bias])


def robot_with(tmp_path, lines):
    path = tmp_path / "mine.toml"
    path.write_text(f"{robot_file('tdcr466').read_text()}\n[[sensor_parameters]]\n{lines}\n")
    return load_robot(path)


GOOD = {"name": '"drift"', "kind": '"bias"', "streams": '["gyro"]', "std": "[0.1, 0.1, 0.1]",
        "correlation_time": "2.5"}  # fmt: skip


def as_lines(entries):
    return "\n".join(f"{key} = {value}" for key, value in entries.items())


def test_a_robot_file_may_state_sensor_parameters(tmp_path):
    (found,) = robot_with(tmp_path, as_lines(GOOD)).sensor_parameters
    assert (found.name, found.kind, found.streams) == ("drift", "bias", ("gyro",))
    assert found.correlation_time == 2.5
    assert not found.known
    np.testing.assert_array_equal(found.std, 0.1)
    frame = {"name": '"f"', "kind": '"frame"', "streams": '["a", "b"]', "std": "[0.01, 0.1]"}
    (found,) = robot_with(tmp_path, as_lines(frame)).sensor_parameters
    np.testing.assert_array_equal(found.std, [0.01] * 3 + [0.1] * 3)
    value = {k: v for k, v in frame.items() if k != "std"} | {"value": "[1, 2, 3, 0, 0, 1]"}
    (found,) = robot_with(tmp_path, as_lines(value)).sensor_parameters
    assert found.known
    np.testing.assert_array_equal(found.value, [1, 2, 3, 0, 0, 1])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"kind": '"colour"'}, f"kind is 'colour'; give one of {KINDS}"),
        ({"std": "[0.1, 0.1]"}, "std is .*; give 3 numbers"),
        ({"std": "[0.1, -0.1, 0.1]"}, "std is .*; give numbers above zero"),
        ({"value": "[1, 2]"}, "value is .*; give 3 numbers"),
        ({"streams": '"gyro"'}, "streams is 'gyro'; give a list of texts"),
        ({"streams": "[]"}, r"streams is \[\]; give a list of texts"),
        ({"correlation_time": "-1"}, "correlation_time is -1; give a number above zero"),
        ({"correlation_time": "0"}, "correlation_time is 0; give a number above zero"),
        ({"corelation_time": "1"}, "is not a key of this table; did you mean 'correlation_time'"),
        ({"name": "3"}, "name is 3; give a text"),
    ],
)
def test_a_mistake_in_a_sensor_parameter_names_file_entry_and_key(tmp_path, changes, sentence):
    where = r"mine.toml \[\[sensor_parameters\]\] 1"
    with pytest.raises(RobotFileError, match=f"{where}: .*{sentence}"):
        robot_with(tmp_path, as_lines({**GOOD, **changes}))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"correlation_time": None}, "correlation_time is None; give seconds"),
        ({"correlation_time": "long"}, "correlation_time is 'long'; give seconds"),
        ({"correlation_time": [1.0, 2.0]}, r"correlation_time is \[1.0, 2.0\]; give seconds"),
        ({"value": "abc"}, "value is 'abc'; give 1 numbers"),
        ({"std": [[0.1], "x"]}, "std is .*; give 1 numbers"),
    ],
)
def test_what_is_no_number_is_one_sentence_in_python_as_well(wrong, sentence):
    given = {"value": [0.0], "std": [0.1]} | wrong
    with pytest.raises(SensorError, match=sentence):
        SensorParameter("late", "time_offset", ("a",), **given)


@pytest.mark.parametrize(
    ("kind", "std"),
    [
        ("frame", "[5, 1]"),
        ("frame", "[0.1, 0.1, 0.1, 10, 10, 10]"),
        ("mount", "[5, 1]"),
        ("arclength_offset", "[8]"),
        ("time_offset", "[20]"),
        ("slide_lag", "[20]"),
        ("slide_play", "[0.3]"),
    ],
)
def test_deviations_in_another_unit_are_one_sentence(tmp_path, kind, std):
    lines = as_lines({**GOOD, "kind": f'"{kind}"', "std": std})
    with pytest.raises(RobotFileError, match=r"give (metres|radians|seconds), of which"):
        robot_with(tmp_path, lines)


def test_a_misspelt_key_is_told_also_where_its_right_name_is_not_given(tmp_path):
    wrong = {key: value for key, value in GOOD.items() if key != "correlation_time"}
    with pytest.raises(RobotFileError, match="did you mean 'correlation_time'"):
        robot_with(tmp_path, as_lines({**wrong, "corelation_time": "1"}))


def test_sensor_parameters_must_be_tables(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f"sensor_parameters = 3\n{robot_file('tdcr466').read_text()}")
    with pytest.raises(RobotFileError, match=r"sensor_parameters.* must be an array of tables"):
        load_robot(path)


def test_what_is_found_after_reading_names_the_file_as_well(tmp_path):
    file, text = tmp_path / "mine.toml", robot_file("tdcr466-segments").read_text()
    far = text.replace("position = [0, 0, 0]", "position = [400, 0, 0]")
    assert far != text
    file.write_text(far)
    with pytest.raises(RobotFileError, match=r"mine.toml: .*base_pose lies 400 m from the origin"):
        load_robot(file)


@pytest.mark.parametrize(("linear", "sound"), [("0.5", False), ("5e-4", True)])
def test_deviations_of_a_tracker_in_millimetres_are_refused(tmp_path, linear, sound):
    head, tail = robot_file("tdcr466").read_text().split("[sensors.coil]\n")
    rest = tail.partition("\n")[2]
    file = tmp_path / "mine.toml"
    file.write_text(f"{head}[sensors.coil]\nstd = [{linear}, 0.01]\n{rest}")
    if sound:
        assert load_robot(file).sensor_std["coil"][0] == 5e-4
        return
    with pytest.raises(RobotFileError, match=r"std is 0.5 m on a robot of 0.466 m; give metres"):
        load_robot(file)
