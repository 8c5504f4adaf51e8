"""Tendons pull the rod into the simulator's shapes, and every slope is that of a difference."""

from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import GlissandoError, NoShapeError, RobotFileError
from glissando.geometry import se3
from glissando.model.tendons.statics import equilibrium
from glissando.model.tendons.tendon_rod import tendon_rod
from glissando.simulation import Loads, solve_shape
from tendon_robot import LENGTH, pulls, simulated, tendon_robot

FINE = np.linspace(0.0, LENGTH, 81)


def solved(robot, tension):
    rod, tendons = simulated(robot)
    return solve_shape(rod, tendons, Loads(tension))


def draw(seed):
    return np.random.default_rng(seed).uniform(0.0, 1.5, (1, 6))


@pytest.mark.parametrize("seed", range(3))
def test_straight_tendons_pull_the_simulators_shape_exactly_with_a_piece_a_segment(seed):
    robot, tension = tendon_robot(), draw(seed)
    found = equilibrium(tendon_rod(robot, np.zeros(0)), tension=tension)
    assert found.strain.shape == (1, 2, 6)
    np.testing.assert_allclose(found.pose()[0, -1], solved(robot, tension[0]).at(LENGTH).pose,
                               atol=1e-9)  # fmt: skip


@pytest.mark.parametrize("kind", ["helical", "rubbing"])
def test_other_tendons_do_the_better_the_finer_the_pieces(kind):
    robot = tendon_robot(**({"pitch": 0.3} if kind == "helical" else {"friction": 0.2}))
    tension = draw(4)
    truth = solved(robot, tension[0]).at(LENGTH).pose
    errors = []
    for count in (5, 17) if kind == "rubbing" else (41, 161):  # fewer would be too few for helices
        rod = tendon_rod(robot, np.linspace(0.0, LENGTH, count))
        miss = equilibrium(rod, tension=tension).pose()[0, -1] - truth
        errors.append(np.abs(miss).max())
    assert errors[1] < 0.1 * errors[0]
    assert errors[1] < 1e-4


@pytest.mark.parametrize("pitch", [0.0, 0.3])
def test_the_manipulators_jacobians_are_differences_of_the_simulators_shapes(pitch):
    robot, tension, nudge = tendon_robot(pitch=pitch), draw(7), 1e-4
    found = equilibrium(tendon_rod(robot, FINE), tension=tension)
    by_strain = found.strain_by_tension()
    by_pose, by_wrench = found.pose_by(by_strain)[0, -1], found.wrench_by(by_strain)[0]
    middle = found.rod.middle
    for j, move in enumerate(nudge * np.eye(6)):
        ahead, behind = (solved(robot, tension[0] + sign * move) for sign in (1.0, -1.0))
        pose = se3.log(se3.inverse(behind.at(LENGTH).pose) @ ahead.at(LENGTH).pose)
        parts = [(by_pose[:, j], pose)]
        for name, slope in (("strain", by_strain[0, :, :, j]), ("wrench", by_wrench[:, :, j])):
            ends = (getattr(shape.at(middle), name) for shape in (ahead, behind))
            parts.append((slope, np.subtract(*ends)))
        for slope, difference in parts:
            expected = difference / (2.0 * nudge)
            assert np.abs(slope - expected).max() < 0.01 * np.abs(expected).max()


def test_slopes_by_displacement_are_differences_of_equilibria():
    robot = tendon_robot()
    rod, pulled = tendon_rod(robot, np.zeros(0)), pulls(np.random.default_rng(1), 5)
    found, nudge = equilibrium(rod, displacement=pulled), 1e-6
    slope = found.pose_by(found.strain_by_displacement())[:, -1]
    for j, move in enumerate(nudge * np.eye(6)):
        ahead, behind = (equilibrium(rod, displacement=pulled + s * move).pose() for s in (1, -1))
        difference = se3.log(se3.inverse(behind[:, -1]) @ ahead[:, -1]) / (2.0 * nudge)
        np.testing.assert_allclose(slope[..., j], difference, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("pitch", [0.0, 0.3])
def test_where_tendons_rub_slopes_are_differences_of_equilibria(pitch):
    rod = tendon_rod(tendon_robot(friction=0.3, pitch=pitch), np.linspace(0.0, LENGTH, 9))
    pulled, moments = pulls(np.random.default_rng(2), 1), np.zeros((len(rod.length), 6))
    at = equilibrium(rod, displacement=pulled)
    free = equilibrium(rod, tension=at.tension)
    for j, move in enumerate(np.eye(6)):
        for slope, given, nudge in (
            (at.strain_by_displacement(), {"displacement": pulled}, 1e-6),
            (free.strain_by_tension(), {"tension": at.tension + 1e-3}, 1e-4),
        ):
            ends = (equilibrium(rod, **{k: v + sign * nudge * move for k, v in given.items()})
                    for sign in (1.0, -1.0))  # fmt: skip
            difference = np.subtract(*(end.strain for end in ends)) / (2.0 * nudge)
            assert np.abs(slope[..., j] - difference).max() < 2e-3 * np.abs(difference).max()
    moments[3, 4] = 1e-6 / rod.stiffness[3, 4]
    ends = (
        equilibrium(replace(rod, rest=rod.rest + sign * moments), displacement=pulled).strain
        for sign in (1.0, -1.0)
    )
    difference = np.subtract(*ends) / 2e-6
    assert (
        np.abs(at.strain_by_moment()[..., 7] - difference).max() < 1e-3 * np.abs(difference).max()
    )


@pytest.mark.parametrize("seed", range(3))
def test_displacements_of_an_equilibrium_give_its_tensions_back(seed):
    rod, tension = tendon_rod(tendon_robot(), np.zeros(0)), draw(seed) + 0.5
    shape, soft = equilibrium(rod, tension=tension), rod.tendons
    stretch = soft.softness * np.log(np.expm1(tension / (soft.stiffness * soft.softness)))
    pulled = rod.shortening(rod.reaches(shape.strain)[2]) + stretch
    np.testing.assert_allclose(equilibrium(rod, displacement=pulled).tension, tension, rtol=1e-6)


def test_slack_tendons_leave_the_rod_straight_and_more_slack_changes_nothing():
    rod = tendon_rod(tendon_robot(), np.zeros(0))
    shapes = [equilibrium(rod, displacement=np.full((1, 6), -d)).pose() for d in (5e-3, 9e-3)]
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-9)
    assert np.abs(shapes[0][0, -1, :3, 3] - [0.0, 0.0, LENGTH]).max() < 1e-8


def test_play_is_the_play_operator_once_it_was_taken_up_and_unknown_until_then():
    robot = tendon_robot(play=[4e-4, 0.0, 1e-3, 0.0, 0.0, 2e-4])
    pulled = np.cumsum(3e-4 * np.random.default_rng(3).standard_normal((200, 6)), axis=0)
    reached, std_in_play = robot.tendons.effective(pulled), robot.tendons.std_in_play(pulled)
    np.testing.assert_allclose(std_in_play[0], robot.tendons.play / np.sqrt(12.0), atol=1e-15)
    assert not std_in_play[-1].any()
    for j, half in enumerate(0.5 * robot.tendons.play):
        state = pulled[0, j] + np.linspace(-half, half, 2001)
        for k, now in enumerate(pulled[:, j]):
            state = np.clip(state, now - half, now + half)
            assert state.mean() == pytest.approx(reached[k, j], abs=2e-3 * half + 1e-12)
            assert state.std() == pytest.approx(
                std_in_play[k, j], rel=2e-3, abs=1e-2 * half + 1e-12
            )


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"end": [0.1, 0.1, 0.1, 0.2, 0.2, 0.25]}, "tendon 5 at 0.25 m, outside the robot of 0.2"),
        ({"radius": 4.5}, "radius is .* give metres"),
        ({"angle": [0, 120, 240, 30, 150, 270]}, "give radians, not degrees"),
        ({"angle": [0, 10, 5, 3, 2, 1]}, "give radians, not degrees .up to a turn"),
        ({"stiffness": [1e4] * 5}, "stiffness is .*give 6 numbers"),
        ({"slack": 3.0}, "slack reaches 3 m"),
        ({"softness": 0.15}, "softness reaches 0.15 m"),
        ({"std": 0.1}, "std reaches 0.1 m"),
        ({"stiffness": 10.0}, "times as much as they bend the robot; give N/m"),
        ({"learned_to": 3.5}, "learned_to reaches 3.5 m on a robot of 0.2 m; give metres"),
        ({"friction": 50.0}, "friction is .* give a coefficient, about 0.1"),
        ({"play": -1e-4}, "play is .* zero or more"),
        ({"tension": 3.0}, "tension is not a key"),
    ],
)
def test_what_tendons_cannot_be_is_one_sentence(wrong, sentence):
    with pytest.raises(RobotFileError, match=sentence):
        tendon_robot(**wrong)


def test_inputs_that_cannot_be_are_one_sentence():
    rod = tendon_rod(tendon_robot(), np.zeros(0))
    for given, sentence in [
        ({"displacement": np.ones((1, 6))}, "not millimetres"),
        ({"displacement": np.zeros((1, 5))}, "5 columns for 6 tendons"),
        ({"tension": -np.ones((1, 6))}, "tendons only pull"),
        ({}, "one of the two"),
    ]:
        with pytest.raises(GlissandoError, match=sentence):
            equilibrium(rod, **given)
    with pytest.raises(NoShapeError, match="row 0"):
        equilibrium(rod, tension=np.full((1, 6), 1e6))


def test_of_many_rows_each_is_computed_as_alone_and_one_without_a_shape_is_numbered():
    """They are computed some at a time, so that memory does not grow by a megabyte each."""
    rod, rng = tendon_rod(tendon_robot(psd_moment=1e-7, std=1e-4)), np.random.default_rng(5)
    pulled = pulls(rng, 230)
    many = equilibrium(rod, displacement=pulled)
    in_play = 1e-4 * rng.uniform(size=pulled.shape)
    cov = many.cov(in_play)
    for k in (0, 99, 100, 229):
        alone = equilibrium(rod, displacement=pulled[k : k + 1])
        np.testing.assert_allclose(many.strain[k], alone.strain[0], atol=1e-9)
        np.testing.assert_allclose(many.pose()[k], alone.pose()[0], atol=1e-9)
        np.testing.assert_allclose(cov[k], alone.cov(in_play[k : k + 1])[0], rtol=1e-6, atol=1e-14)
    rest = rod.rest + 0.1 * rng.standard_normal((230, *rod.rest.shape))  # each shape its own
    own = equilibrium(replace(rod, rest=rest), displacement=pulled)
    alone = equilibrium(replace(rod, rest=rest[150]), displacement=pulled[150:151])
    np.testing.assert_allclose(own.strain[150], alone.strain[0], atol=1e-9)
    np.testing.assert_allclose(own.cov(in_play)[150], alone.cov(in_play[150])[0], rtol=1e-6)
    pulled[217, 0] = 0.19
    with pytest.raises(NoShapeError, match="row 217"):
        equilibrium(rod, displacement=pulled)
