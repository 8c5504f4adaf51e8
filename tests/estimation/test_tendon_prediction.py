"""What tendons predict does not depend on what is asked, and says what it leaves out."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import FalseConfidenceWarning, GlissandoError
from glissando.estimation.tendon_prediction import predict, predict_tip
from glissando.geometry import se3
from glissando.io.robot_file import load_robot
from glissando.io.robot_writer import save_robot
from glissando.model.sensors.parameters import SensorParameter
from tendon_robot import LENGTH, STIFFNESS, tendon_robot, with_replicates

TIME = np.zeros(1)


def commands(seed):
    return 2e-3 * np.random.default_rng(seed).uniform(-1.0, 1.0, (1, 6))


@pytest.mark.parametrize("pitch", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_same_whichever_places_are_asked_for(pitch, seed):
    robot = tendon_robot(pitch=pitch, psd_moment=1e-7, std=1e-4)
    fine = np.linspace(0.0, LENGTH, 201)
    rng = np.random.default_rng(seed)
    few = np.sort(rng.choice(fine[1:], 3, replace=False))
    every, some, tip = (
        predict(robot, TIME, commands(seed), places) for places in (fine, few, np.array([LENGTH]))
    )
    at = np.searchsorted(fine, few)
    np.testing.assert_allclose(some.position[0], every.position[0, at], atol=1e-4)
    np.testing.assert_allclose(some.std_position[0], every.std_position[0, at], rtol=0.03)
    np.testing.assert_allclose(tip.position[0, -1], every.position[0, -1], atol=1e-4)
    np.testing.assert_allclose(tip.std_position[0, -1], every.std_position[0, -1], rtol=0.03)


def test_a_base_that_may_stand_elsewhere_moves_all_that_is_predicted():
    robot, var = tendon_robot(psd_moment=1e-7, std=1e-4), np.repeat([1e-4, 1e-2], 3)
    sure, unsure = (
        predict(replace(robot, prior=replace(robot.prior, var_base=v)), TIME, commands(1))
        for v in (np.full(6, 1e-15), var)
    )
    back = se3.adjoint(se3.inverse(sure.pose) @ robot.prior.base_pose)
    added = back @ np.diag(var) @ np.swapaxes(back, -1, -2)
    np.testing.assert_allclose((unsure.cov - sure.cov)[..., :6, :6], added, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_a_marker_is_predicted_as_surely_as_its_place_on_the_body(seed):
    robot = tendon_robot(psd_moment=1e-7, std=3e-4)
    robot = replace(robot, sensor_std={**robot.sensor_std, "position": np.full(3, 1e-4)})
    mount, frame = (se3.exp(robot.stated_transform(kind, "tip")) for kind in ("mount", "frame"))
    for pulled in (commands(seed), np.zeros((1, 6))):  # bent, and straight, where (34) counts most
        body = predict(robot, TIME, pulled, np.array([LENGTH]))
        place, cov = predict_tip(robot, pulled, "tip")
        at = se3.inverse(frame) @ body.pose[0, -1] @ mount
        own = at[:3, :3] @ body.position_covariance(mount)[0, -1] @ at[:3, :3].T
        np.testing.assert_allclose(place[0], at[:3, 3], atol=1e-12)
        np.testing.assert_allclose(cov[0], own + 1e-8 * np.eye(3), rtol=1e-6, atol=1e-14)


@pytest.mark.slow
def test_velocities_at_uneven_times_are_as_uncertain_as_commands_make_them():
    robot = tendon_robot(psd_moment=1e-7, std=1e-4)
    time = np.array([0.0, 1.0, 1.02, 2.0, 2.02, 3.0])
    pull = np.linspace(0.3, 1.0, 6)[:, None] * 3e-3 * np.array([1.0, -0.5, -0.5, 0.3, 0.2, -0.4])
    tip, rng = np.array([LENGTH]), np.random.default_rng(3)
    claimed = predict(robot, time, pull, tip).cov[:, 0, 12:18, 12:18]
    drawn = [
        predict(robot, time, pull + 1e-4 * rng.standard_normal(pull.shape), tip).velocity[:, 0]
        for _ in range(100)
    ]
    spread = np.trace(claimed[:, 3:, 3:], axis1=1, axis2=2) / np.var(drawn, axis=0)[:, 3:].sum(-1)
    assert np.all((spread > 0.6) & (spread < 1.6))


def test_weight_that_is_left_out_is_named_where_it_bends_the_robot():
    robot = tendon_robot(slack=0.01, psd_moment=1e-7, std=1e-4)
    heavy = replace(robot.prior.mechanics, gravity=np.array([9.81, 0.0, 0.0]), tip_mass=0.002)
    for mechanics, heard in ((heavy, True), (replace(heavy, tip_mass=0.0), False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", FalseConfidenceWarning)
            predict(
                replace(robot, prior=replace(robot.prior, mechanics=mechanics)), TIME, commands(2)
            )
        assert bool(caught) == heard
    assert heavy.gravity[0] > 0.0


@pytest.mark.parametrize(
    "given", [np.zeros((1, 5)), np.zeros((2, 6)), np.full((1, 6), np.nan), np.zeros(5)]
)
def test_commands_of_another_shape_are_a_sentence(given):
    with pytest.raises(GlissandoError, match=r"give \(1, 6\), a row a time and a column a tendon"):
        predict(tendon_robot(psd_moment=1e-7, std=1e-4), TIME, given)


def test_a_single_time_and_place_are_taken_as_they_are():
    robot = tendon_robot(psd_moment=1e-7, std=1e-4)
    alone = predict(robot, 0.0, commands(1)[0], LENGTH)
    np.testing.assert_allclose(
        alone.position, predict(robot, TIME, commands(1), np.array([LENGTH])).position
    )


@pytest.mark.parametrize("count", [1, 6])
def test_replicates_of_what_was_learned_add_the_jackknifes_covariance(count):
    stated = SensorParameter("f", "frame", ("tip",), np.zeros(6), np.zeros(6))
    plain = tendon_robot(psd_moment=1e-7, std=1e-4)
    plain = replace(plain, sensor_parameters=(*plain.sensor_parameters, stated))
    robot, others = with_replicates(plain, count, seed=count)
    pulled = 2e-3 * np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    moved, bare = (predict(each, np.arange(5.0), pulled) for each in (robot, plain))
    np.testing.assert_array_equal(moved.pose, bare.pose)
    expected = np.zeros((*bare.cov.shape[:2], 12, 12))
    for other in (predict(each, np.arange(5.0), pulled) for each in others):
        turned = se3.log(se3.inverse(bare.pose) @ other.pose)
        off = np.concatenate([turned, other.strain - bare.strain], axis=-1)
        expected += (count - 1) / count * off[..., :, None] * off[..., None, :]
    np.testing.assert_allclose((moved.cov - bare.cov)[..., :12, :12], expected, atol=1e-9)

    (place, cov), (same, without) = (predict_tip(each, pulled, "tip") for each in (robot, plain))
    np.testing.assert_array_equal(place, same)
    off = np.stack([predict_tip(each, pulled, "tip")[0] - place for each in others])
    expected = (count - 1) / count * np.einsum("kmi,kmj->mij", off, off)
    np.testing.assert_allclose(cov - without, expected, atol=1e-12)


def test_what_is_left_open_adds_its_squares_in_the_robots_frame_and_not_to_the_marker():
    plain = tendon_robot(psd_moment=1e-7, std=1e-4)
    robot, others = with_replicates(plain, 3, seed=2)
    robot = replace(robot, tendons=replace(plain.tendons, left_open=robot.tendons.replicates))
    pulled = 2e-3 * np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    moved, bare = (predict(each, np.arange(5.0), pulled) for each in (robot, plain))
    expected = np.zeros((*bare.cov.shape[:2], 6, 6))
    for other in (predict(each, np.arange(5.0), pulled) for each in others):
        turned = se3.log(se3.inverse(bare.pose) @ other.pose)
        expected += turned[..., :, None] * turned[..., None, :]
    np.testing.assert_allclose((moved.cov - bare.cov)[..., :6, :6], expected, atol=1e-9)
    np.testing.assert_array_equal(*(predict_tip(each, pulled, "tip")[1] for each in (robot, plain)))


@pytest.mark.parametrize("key", ["replicates", "left_open"])
def test_replicates_are_written_to_a_robot_file_and_read_as_they_were(tmp_path, key):
    robot, _ = with_replicates(tendon_robot(), 6, seed=0)
    others = {"replicates": (), key: robot.tendons.replicates}
    robot = replace(robot, tendons=replace(robot.tendons, **others))
    save_robot(robot, tmp_path / "robot.toml")
    again = getattr(load_robot(tmp_path / "robot.toml").tendons, key)
    assert len(again) == 6
    for one, other in zip(others[key], again, strict=True):
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("radius", [0.0045] * 5, "give 6 numbers"),
        ("stiffness", [-1e4] * 6, "above zero"),
        ("section_stiffness", [STIFFNESS], "give 2 rows"),
        ("section_stiffness", [STIFFNESS, [-1.0] * 6], "not above zero"),
        ("play", [-1e-4] * 6, "zero or more"),
        ("angles", [0.0] * 6, "did you mean 'angle'"),
    ],
)
def test_a_replicate_of_another_robot_is_a_sentence_that_names_it(key, value, words):
    robot, _ = with_replicates(tendon_robot(), 2, seed=0)
    entries = robot.tendons.to_table()["replicates"]
    entries[1][key] = value
    with pytest.raises(GlissandoError, match=words) as caught:
        tendon_robot(replicates=entries)
    assert "[[replicates]] 2" in str(caught.value)
