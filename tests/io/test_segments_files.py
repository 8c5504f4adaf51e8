"""Segments in robot files."""

import numpy as np
import pytest

from glissando import WhiteNoisePrior, estimate, load_robot
from glissando.errors import RobotFileError
from glissando.model.priors.separable import SeparablePrior

ROBOT = """
name = "two"
length = 0.4

[grid]
arclength_nodes = 4
time_rate = 10.0

[base]
{base}

[prior]
{prior}
joints = [0.15, 0.3]
psd_strain_arclength = [[1e-3, 10], [2e-3, 20], [1e-3, 1e-3, 2e-3, 5, 6, 7]]
{jumps} = [[1e-5, 25], [0, 0, 0, 1, 2, 3]]
"""
SEPARABLE = {
    "base": "var_pose = [1e-6, 1e-4]\nvar_strain = [1e-4, 4]",
    "prior": 'kind = "separable"\ntime_scale = 2.0',
    "jumps": "var_jumps",
}
KINEMATIC = {
    "base": "psd_pose = [1e-6, 1e-4]\npsd_strain = [1e-4, 4]\npsd_velocity = [1, 1]",
    "prior": 'kind = "white-noise"\n'
    + "\n".join(
        f"psd_{name} = [1, 2]" for name in ("velocity_time", "strain_time", "velocity_arclength")
    ),
    "jumps": "psd_jumps",
}
FILES = pytest.mark.parametrize("parts", [SEPARABLE, KINEMATIC], ids=["separable", "kinematic"])


def robot_of(folder, text):
    (folder / "two.toml").write_text(text)
    return load_robot(folder / "two.toml")


@FILES
def test_a_robot_file_states_joints_and_what_differs_between_segments(parts, tmp_path):
    robot = robot_of(tmp_path, ROBOT.format(**parts))
    prior = robot.prior
    assert isinstance(prior, SeparablePrior if parts is SEPARABLE else WhiteNoisePrior)
    np.testing.assert_array_equal(prior.joints, [0.15, 0.3])
    psd = [[1e-3] * 3 + [10] * 3, [2e-3] * 3 + [20] * 3, [1e-3, 1e-3, 2e-3, 5, 6, 7]]
    np.testing.assert_array_equal(prior.psd_strain_arclength, psd)
    np.testing.assert_array_equal(prior.jumps, [[1e-5] * 3 + [25] * 3, [0, 0, 0, 1, 2, 3]])
    nodes = [0, 0.4 / 3, 0.15, 0.8 / 3, 0.3, 0.4]
    np.testing.assert_allclose(robot.arclength_nodes, nodes, rtol=0, atol=1e-15)
    assert estimate(prior, robot.grid(0.0, 0.5), []).solve.converged


def test_joints_that_are_nodes_already_are_not_added_again(tmp_path):
    text = ROBOT.format(**SEPARABLE)
    text = text.replace("arclength_nodes = 4", "arclength_nodes = [0, 0.1, 0.15, 0.3, 0.4]")
    robot = robot_of(tmp_path, text)
    np.testing.assert_array_equal(robot.arclength_nodes, [0, 0.1, 0.15, 0.3, 0.4])
    robot = robot_of(tmp_path, text.replace("0.15, 0.3]\npsd", "0.15, 0.3000000001]\npsd"))
    assert len(robot.arclength_nodes) == 5
    assert estimate(robot.prior, robot.grid(0.0, 0.5), []).solve.converged


def test_the_shipped_robot_of_segments_says_more_where_its_tendons_end():
    robot = load_robot("tdcr466-segments")
    assert 0.233 in robot.arclength_nodes
    at = estimate(robot.prior, robot.grid(0.0, 0.2), []).at([0.2329, 0.233], 0.1)
    variance = np.einsum("mii->mi", at.cov)[:, 9:12]
    np.testing.assert_allclose(variance[1] - variance[0], robot.prior.jumps[0, 3:], rtol=2e-2)


MISTAKES = [
    ("[0.15, 0.3]", "[0.3, 0.15]", "joints must increase from above 0"),
    ("[0.15, 0.3]", "[0.15, 0.15]", "joints must increase from above 0"),
    ("[0.15, 0.3]", "[0.0, 0.3]", "joints must increase from above 0"),
    ("[0.15, 0.3]", "[-0.1, 0.3]", "joints must increase from above 0"),
    ("[0.15, 0.3]", "[0.15, 0.4]", "at 0.4 m, at or beyond the tip"),
    ("[0.15, 0.3]", "[0.15, 0.5]", "at 0.5 m, at or beyond the tip"),
    ("[0.15, 0.3]", "[]", r"joints is \[\]; give a list of numbers"),
    ("[0.15, 0.3]", "0.15", "joints is 0.15; give a list of numbers"),
    ("[0.15, 0.3]", '["a", 0.3]', "joints is .*; give numbers"),
    ("[0.15, 0.3]", "[0.15]", "psd_strain_arclength is .*; give 2 rows"),
    ("[0.15, 0.3]", "[0.1, 0.2, 0.3]", "psd_strain_arclength is .*; give 4 rows"),
    ("[[1e-3, 10], ", "[", "psd_strain_arclength is .*; give 3 rows"),
    ("[[1e-3, 10], ", "[[1e-3, 0], ", "psd_strain_arclength is .*; give numbers above zero"),
    ("[[1e-3, 10], ", "[[1e-3, 10, 1], ", "psd_strain_arclength is .*; give 6 numbers, or 2"),
    ("= [[1e-3, 10], ", "= [1e-3, 10] #", "psd_strain_arclength is .*; give 3 rows"),
    ("[1e-5, 25], ", "", "_jumps is .*; give 2 rows"),
    ("[1e-5, 25], ", "[1e-5, -25], ", "_jumps is .*; give no number below zero"),
    ("[1e-5, 25], ", "[1e-5], ", "_jumps is .*; give 6 numbers, or 2"),
    ("{jumps} = [[1e-5, 25]", "# [[1e-5, 25]", "_jumps is missing; give 2 rows"),
    ("{jumps} =", "jumps =", "_jumps is missing; give 2 rows"),
    ("joints = [0.15, 0.3]", "", "psd_strain_arclength is .*; give 6 numbers"),
]


@FILES
@pytest.mark.parametrize(("right", "wrong", "sentence"), MISTAKES)
def test_mistakes_about_segments_are_told_in_one_sentence(parts, right, wrong, sentence, tmp_path):
    assert right in ROBOT
    text = ROBOT.replace(right, wrong).format(**parts)
    with pytest.raises(RobotFileError, match=sentence) as told:
        robot_of(tmp_path, text)
    message = str(told.value)
    assert message.startswith("two.toml")
    assert "\n" not in message


def test_jumps_without_joints_are_refused(tmp_path):
    text = ROBOT.format(**SEPARABLE).replace("joints = [0.15, 0.3]\n", "")
    text = text.replace("[[1e-3, 10], [2e-3, 20], [1e-3, 1e-3, 2e-3, 5, 6, 7]]", "[1e-3, 10]")
    with pytest.raises(RobotFileError, match="var_jumps is not a key of this table"):
        robot_of(tmp_path, text)
