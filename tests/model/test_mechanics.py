"""A robot file's [mechanics]: what it says is kept, and what cannot be is refused in a sentence."""

import numpy as np
import pytest

from glissando.errors import RobotFileError
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file
from glissando.model.mechanics import Mechanics, read_mechanics
from glissando.model.table import Table
from glissando.simulation import Rod

TUBES = """
[mechanics]
tubes = [{ outer = 2.0e-3, inner = 1.8e-3 }, { outer = 1.2e-3, inner = 0.8e-3, end = 0.3 }]
young = 60e9
poisson = 0.33
density = 6450
gravity = [0, 0, -9.81]

[mechanics.tip]
mass = 2e-3
center = [0, 0, 5e-3]
"""


def load(folder, text):
    """The robot of 0.466 m with this [mechanics]."""
    path = folder / "robot.toml"
    path.write_text(robot_file("tdcr466").read_text() + text)
    return load_robot(path)


def test_tubes_that_end_make_segments_as_the_simulators_tubes_do(tmp_path):
    found = load(tmp_path, TUBES).mechanics
    both, outer = [(2.0e-3, 1.8e-3), (1.2e-3, 0.8e-3)], [(2.0e-3, 1.8e-3)]
    for row, tubes in enumerate((both, outer)):
        rod = Rod.of_tubes(0.466, tubes, young=60e9, poisson=0.33, density=6450)
        np.testing.assert_allclose(found.stiffness[row], rod.stiffness, rtol=1e-12)
        assert found.mass_per_length[row] == pytest.approx(rod.mass_per_length, rel=1e-12)
    assert found.joints.tolist() == [0.3]
    assert found.segment(np.array([0.29, 0.3, 0.4])).tolist() == [0, 1, 1]


def test_the_tool_hangs_on_the_tip(tmp_path):
    found = load(tmp_path, TUBES).mechanics
    lying = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # tangent along world x
    force = lying.T @ [0, 0, -9.81 * 2e-3]
    expected = np.concatenate([force, np.cross([0, 0, 5e-3], force)])
    np.testing.assert_allclose(found.tip_wrench(lying), expected, atol=1e-15)


def test_what_is_written_is_what_was_read(tmp_path):
    found = load(tmp_path, TUBES).mechanics
    again = read_mechanics(Table({"mechanics": found.to_table()}, "again", RobotFileError))
    for name, value in vars(found).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def test_one_mass_is_that_of_every_segment():
    mechanics = Mechanics(np.ones((3, 6)), joints=np.array([0.1, 0.2]))
    np.testing.assert_array_equal(mechanics.mass_per_length, np.zeros(3))


def test_a_robot_without_mechanics_has_none():
    assert load_robot("tdcr466").mechanics is None


STIFF = "\n[mechanics]\nstiffness = [1e5, 1e5, 2e5, 0.06, 0.06, 0.05]\nmass_per_length = 0.016\n"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("young = 60e9", "young = 60", "give pascals"),
        ("inner = 1.8e-3", "inner = 0.5e-3", "tubes fit into each other"),
        ("young = 60e9", "young = 60e3", "could not carry its own weight"),
        ("poisson = 0.33", "poisson = 33", "give a ratio"),
        ("density = 6450", "density = 6.45", "give kg/m³"),
        ("density = 6450", "density = -6450", "give kg/m³"),
        ("outer = 2.0e-3", "outer = 2.0", "not millimetres"),
        ("inner = 1.8e-3", "inner = 2.8e-3", "outer > inner"),
        ("end = 0.3", "end = 300", "beyond the tip"),
        ("inner = 1.8e-3", "inner = 1.8e-3, end = 0.4", "all end by 0.4 m, before the tip at"),
        ("gravity = [0, 0, -9.81]", "gravity = [0, 0, -1]", "in m/s²"),
        ("gravity = [0, 0, -9.81]", "gravity = [0, 0, -9810]", "in m/s²"),
        ("mass = 2e-3", "mass = -2e-3", "above zero"),
        ("mass = 2e-3", "mass = 20", "not grams"),
        ("center = [0, 0, 5e-3]", "center = [0, 0, 5]", "not millimetres"),
        ("poisson = 0.33", "poissson = 0.33", "poisson"),
    ],
)
def test_wrong_units_and_impossible_tubes_are_one_sentence(tmp_path, old, new, sentence):
    assert old in TUBES
    with pytest.raises(RobotFileError, match=sentence):
        load(tmp_path, TUBES.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("0.06, 0.06, 0.05", "6e4, 6e4, 5e4", "m thick"),
        ("0.06, 0.06, 0.05", "-0.06, 0.06, 0.05", "above zero"),
        ("0.016", "-0.016", "zero or more"),
        ("0.016", "16e3", "give kg/m"),
        ("1e5, 1e5, 2e5, 0.06, 0.06, 0.05", "1e5, 1e5", "m thick"),
    ],
)
def test_wrong_units_of_stiffness_are_one_sentence(tmp_path, old, new, sentence):
    load(tmp_path, STIFF)
    assert old in STIFF
    with pytest.raises(RobotFileError, match=sentence):
        load(tmp_path, STIFF.replace(old, new))
