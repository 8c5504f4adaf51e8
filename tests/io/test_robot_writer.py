"""Robots as files: what is written is what was there."""

from dataclasses import fields, replace

import numpy as np
import pytest

from glissando import (
    GemanMcClure,
    GlissandoError,
    Huber,
    Robot,
    SensorParameter,
    load_robot,
    save_robot,
)
from glissando.io.shipped_robots import shipped_robots
from glissando.model.tube import Tube


def require_same(one, other):
    """Raise AssertionError unless two robots, or parts of them, hold the same numbers."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            require_same(one[key], other[key])
    elif isinstance(one, tuple | list):
        assert len(one) == len(other)
        for each, its in zip(one, other, strict=True):
            require_same(each, its)
    elif hasattr(one, "__dataclass_fields__"):
        for each in fields(one):
            if each.name != "file":
                require_same(getattr(one, each.name), getattr(other, each.name))
    else:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", shipped_robots())
def test_a_shipped_robot_is_read_as_it_was_written(name, tmp_path):
    robot = load_robot(name)
    save_robot(robot, tmp_path / "again.toml")
    again = load_robot(tmp_path / "again.toml")
    assert again.file == tmp_path / "again.toml"
    require_same(robot, again)


def test_everything_a_robot_of_ones_own_holds_is_read_again(tmp_path):
    zero, roll_known = np.zeros(6), np.array([1e-3, 1e-3, 1e-3, 0.01, 0.01, 0.0])
    robot = replace(
        load_robot("tdcr466"),
        name='a "robot" \\ of µ',
        sensor_std={"pose": np.full(6, 1e-3), "gyro": np.full(3, 0.02)},
        sensor_loss={"pose": Huber(2.5), "gyro": GemanMcClure(7.0)},
        sensor_range={"gyro": 5.0},
        sensor_rate={"pose": 40.0},
        sensor_parameters=(
            SensorParameter("mount", "mount", ("a", "b"), zero, roll_known, 3.0),
            SensorParameter("late", "time_offset", ("a",), [0.02], [0.0]),
            SensorParameter("clock", "time_offset", ("b",), [0.0], [0.01]),
        ),
        tube=Tube(0.95, 2.5, 40, 1.0),
        nodes_at_readings=True,
    )
    save_robot(robot, tmp_path / "own.toml")
    require_same(robot, load_robot(tmp_path / "own.toml"))


class Cauchy:
    """A loss that no robot file knows."""

    threshold = 1.0

    def weight(self, norm):
        return 1.0 / (1.0 + norm**2)

    def cost(self, norm):
        return 0.5 * np.log1p(norm**2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sensor_loss": {"pose": Cauchy()}}, "cannot name the loss"),
        ({"sensor_rate": {"fbg": 40.0}}, "'fbg' have a rate and no standard deviation"),
    ],
)
def test_what_a_file_cannot_say_is_a_sentence_and_leaves_the_old_file(changes, words, tmp_path):
    robot, path = load_robot("tdcr466"), tmp_path / "robot.toml"
    save_robot(robot, path)
    before = path.read_bytes()
    with pytest.raises(GlissandoError, match=words):
        save_robot(replace(robot, **changes), path)
    assert path.read_bytes() == before


def test_what_is_no_robot_is_a_sentence(tmp_path):
    with pytest.raises(GlissandoError, match="give the robot, and then the file"):
        save_robot(tmp_path / "robot.toml", load_robot("tdcr466"))
    assert isinstance(load_robot("tdcr466"), Robot)
