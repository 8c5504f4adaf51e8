"""Shapes estimated together: the same as each by itself at a single moment."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

import separable_sessions as drawn
from draws import generators, law
from glissando import (
    BaseVariance,
    CoilReadings,
    FalseConfidenceWarning,
    FbgReadings,
    GemanMcClure,
    Grid,
    GyroReadings,
    Huber,
    NotConvergedWarning,
    PoseReadings,
    PositionReadings,
    SeparablePrior,
    StrainReadings,
    estimate,
    estimate_static,
    load_robot,
    sample_static,
)
from glissando.errors import OutsideGridError, SensorError, UnobservableError
from glissando.estimation import static as method
from glissando.estimation import static_iteration
from glissando.evaluation.metrics import errors_against
from glissando.geometry import se3
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.solver.gauss_newton import SolverOptions

EXACT = SolverOptions(tolerance=1e-6)
PRIORS = {
    "kinematic": load_robot("sliding700").prior,
    "separable": replace(load_robot("tdcr466-segments").prior, base_pose=se3.exp(np.full(6, 0.1))),
}
LENGTHS = {"kinematic": 0.7, "separable": 0.466}


def nodes_of(kind):
    return np.union1d(np.linspace(0.0, LENGTHS[kind], 5), PRIORS[kind].joints)


def strains(rng, count, bend):
    """Constant strains (S, 6), bent by about so many rad/m."""
    return STRAIGHT + bend * rng.standard_normal((count, 6)) * [0, 0, 0, 1, 1, 0]


def readings_of(rng, kind, count, bend=1.0):
    """Sensors of several kinds on bent shapes, at nodes and between, not all on every shape."""
    length, prior = LENGTHS[kind], PRIORS[kind]
    bent = np.array([0, 0, 1.0, 0, 0, 0]) + bend * rng.standard_normal((count, 6)) * [
        0,
        0,
        0,
        1,
        1,
        0,
    ]

    def seen(places, shapes, size):
        pose = prior.base_pose @ se3.exp(places[:, None] * bent[shapes])
        return pose @ se3.exp(size * rng.standard_normal((len(places), 6)))

    shapes = rng.integers(0, count, 4 * count)
    places = np.where(
        rng.uniform(size=shapes.size) < 0.3, length, length * rng.uniform(size=shapes.size)
    )
    at = {"time": shapes, "arclength": places}
    coil = CoilReadings(**at, values=seen(places, shapes, 1e-3), cov=1e-5, loss=Huber(3.0))
    every = np.arange(count)
    middle = np.full(count, 0.5 * length)
    at = {"time": every, "arclength": middle}
    position = PositionReadings(**at, values=seen(middle, every, 1e-3)[:, :3, 3], cov=1e-6)
    strain = StrainReadings(**at, values=bent, cov=1e-2)
    fibre = {"core_radius": np.full(3, 1e-3), "core_angle": np.arange(3.0)}
    fbg = FbgReadings(**at, values=1e-4 * rng.standard_normal((count, 3)), cov=1e-4, **fibre)
    return [coil, position, strain, fbg]


def alone(prior, nodes, readings, shape):
    """The slow twin: one shape at a single moment."""
    mine = [r.select(r.time == shape) for r in readings]
    mine = [r.changed(time=np.zeros(len(r))) for r in mine]
    return estimate(prior, Grid(nodes, [0.0]), mine, options=EXACT)


def assert_same(together, one, shape, places):
    found, wanted = together.at(places, shape), one.at(places, 0.0)
    np.testing.assert_allclose(found.pose, wanted.pose, atol=1e-6)
    np.testing.assert_allclose(found.strain, wanted.strain, atol=1e-4)
    scale = np.sqrt(np.einsum("mii->mi", wanted.cov[:, :12, :12]))
    scale = scale[:, :, None] * scale[:, None, :]
    assert np.all(np.abs(found.cov[:, :12, :12] - wanted.cov[:, :12, :12]) <= 1e-3 * scale + 1e-20)


@pytest.mark.slow
@settings(law, max_examples=5)
@given(generators)
@pytest.mark.parametrize("kind", PRIORS)
def test_shapes_together_are_each_by_itself(kind, rng):
    count, prior, nodes = int(rng.integers(1, 5)), PRIORS[kind], nodes_of(kind)
    readings = readings_of(rng, kind, count)
    together = estimate_static(prior, nodes, readings, count=count, options=EXACT)
    assert together.converged.all()
    places = np.sort(LENGTHS[kind] * rng.uniform(size=4))
    for shape in range(count):
        one = alone(prior, nodes, readings, shape)
        assert_same(together, one, shape, np.concatenate([places, nodes]))


def test_shapes_do_not_know_of_each_other():
    """The third is the same whatever the others are, and however many."""
    rng = np.random.default_rng(0)
    prior, nodes = PRIORS["separable"], nodes_of("separable")
    readings = readings_of(rng, "separable", 6)
    whole = estimate_static(prior, nodes, readings, options=EXACT)
    third = [r.select(r.time == 2) for r in readings]
    single = estimate_static(prior, nodes, third, count=9, options=EXACT)
    found, wanted = (s.at(nodes, 2) for s in (single, whole))
    np.testing.assert_allclose(found.pose, wanted.pose, atol=1e-6)
    np.testing.assert_allclose(found.std_position, wanted.std_position, rtol=1e-5)


def test_a_shape_that_nobody_read_is_as_uncertain_as_the_prior():
    prior, nodes = PRIORS["separable"], nodes_of("separable")
    together = estimate_static(prior, nodes, [], count=2)
    one = estimate(prior, Grid(nodes, [0.0]), [])
    assert_same(together, one, 1, np.array([0.05, 0.466]))


def test_nearly_rigid_shear_and_right_angles_converge_from_rest(monkeypatch):
    """Where straight steps tear the shape apart; none is left to the slow way.

    This prior does not expect such bends.
    """
    monkeypatch.setattr(method, "BatchProblem", None)
    monkeypatch.setattr(static_iteration, "implausible", lambda *_: False)
    rng = np.random.default_rng(1)
    prior = replace(
        drawn.PRIOR,
        psd_strain_arclength=np.array([1e-9] * 3 + [4.0, 4.0, 0.5]),
        joints=np.zeros(0),
        jumps=np.zeros((0, 6)),
    )
    count, length = 40, 0.5
    bent = np.array([0, 0, 1.0, 0, 0, 0]) + 3.0 * rng.standard_normal((count, 6)) * [
        0,
        0,
        0,
        1,
        1,
        0,
    ]
    tips = prior.base_pose @ se3.exp(length * bent)
    tip = PoseReadings(
        time=np.arange(count), arclength=np.full(count, length), values=tips, cov=1e-5
    )
    nodes = np.linspace(0.0, length, 6)
    assert estimate_static(prior, nodes, [tip]).converged.all()


def test_systems_that_rounding_alone_makes_singular_are_damped_on_the_way():
    """Softened to begin with, a rod of nitinol among others; at the end nothing is damped."""
    rng, count, length = np.random.default_rng(5), 6, 0.4
    bending = np.array([4.08, 3.51, 1.42, 1.32])
    prior = SeparablePrior(
        np.stack([[1e-9] * 3 + [q, q, 1e-9] for q in bending]),
        1.0,
        BaseVariance(np.full(6, 1e-10), np.array([1e-9] * 3 + [4.9, 4.9, 2.3])),
        joints=np.array([0.1, 0.2, 0.3]),
        jumps=np.array([[1e-9] * 6, [1e-9] * 3 + [1.2, 1.2, 2.0], [1e-9] * 6]),
    )
    bent = np.array([0, 0, 1.0, 0, 0, 0]) + [0, 0, 0, 3, 3, 1] * rng.standard_normal((count, 6))
    tip = CoilReadings(
        time=np.arange(count),
        arclength=np.full(count, length),
        values=se3.exp(length * bent),
        cov=np.repeat([5e-7, 5e-5], [3, 2]),
    )
    nodes = np.linspace(0.0, length, 13)
    together = estimate_static(prior, nodes, [tip], options=EXACT)
    assert together.converged.all()
    places = np.array([0.05, 0.2, 0.4])
    for shape in range(2):
        found, wanted = together.at(places, shape), alone(prior, nodes, [tip], shape).at(places, 0)
        np.testing.assert_allclose(found.pose, wanted.pose, atol=1e-6)
        np.testing.assert_allclose(found.std_position, wanted.std_position, rtol=0.01)


@pytest.mark.slow
def test_a_shape_that_steps_do_not_lead_to_is_left_to_the_estimator_of_recordings(monkeypatch):
    """All are, if no step is ever worth it; and those that it gives up are said to be so."""
    rng = np.random.default_rng(2)
    prior, nodes = PRIORS["separable"], nodes_of("separable")
    readings = readings_of(rng, "separable", 3)
    known = estimate_static(prior, nodes, readings, options=EXACT)
    monkeypatch.setattr(static_iteration, "WORTHWHILE", np.inf)
    left = estimate_static(prior, nodes, readings, options=EXACT)
    for shape in range(3):
        found, wanted = (which.at(nodes, shape) for which in (left, known))
        np.testing.assert_allclose(found.pose, wanted.pose, atol=1e-6)
        np.testing.assert_allclose(found.std_position, wanted.std_position, rtol=1e-5)
    with pytest.warns(NotConvergedWarning, match="^Shapes 0, 1, 2 are not converged") as warned:
        hasty = estimate_static(prior, nodes, readings, options=SolverOptions(max_iterations=1))
    assert not hasty.converged.any()
    assert len(warned) == 1
    assert "time" not in str(warned[0].message)

    def singular(*_):
        raise UnobservableError("It has no digits.")

    monkeypatch.setattr(method, "_alone", singular)
    with pytest.raises(UnobservableError, match=r"^Shape 0: It has no digits"):
        estimate_static(prior, nodes, readings, options=SolverOptions(max_iterations=1))


@pytest.mark.slow
def test_truth_judges_shapes_by_their_numbers():
    rng = np.random.default_rng(3)
    prior, nodes = PRIORS["separable"], nodes_of("separable")
    readings = readings_of(rng, "separable", 4)
    together = estimate_static(prior, nodes, readings, options=EXACT)
    found = errors_against(together, readings[1])
    for shape in range(4):
        mine = readings[1].select(readings[1].time == shape)
        mine = mine.changed(time=np.zeros(1))
        wanted = errors_against(alone(prior, nodes, readings, shape), mine)
        assert found.position[shape] == pytest.approx(wanted.position[0], abs=1e-6)
        assert found.nees_position[shape] == pytest.approx(wanted.nees_position[0], rel=1e-3)


def test_mistakes_are_one_sentence():
    prior, nodes = PRIORS["separable"], nodes_of("separable")
    at = {"time": [0, 0.5], "arclength": [0.1, 0.1]}
    with pytest.raises(OutsideGridError, match=r"row 1 is of shape 0.5; shapes are numbered"):
        estimate_static(prior, nodes, [PositionReadings(**at, values=np.zeros((2, 3)), cov=1.0)])
    at["time"] = [1.7e9, 1.7e9 + 1]
    with pytest.raises(OutsideGridError, match=r"1,700,000,002 shapes and about .* number the"):
        estimate_static(prior, nodes, [PositionReadings(**at, values=np.zeros((2, 3)), cov=1.0)])
    at = {"time": [0, 1], "arclength": [0.1, 0.1]}
    with pytest.raises(SensorError, match="spin: a shape that holds still has no velocity"):
        estimate_static(
            prior, nodes, [GyroReadings(**at, values=np.zeros((2, 3)), cov=1.0, name="spin")]
        )
    free = replace(PRIORS["kinematic"], base=None)
    with pytest.raises(UnobservableError, match="leave a direction of a shape undetermined"):
        estimate_static(free, nodes, [PositionReadings(**at, values=np.zeros((2, 3)), cov=1.0)])
    with pytest.raises(OutsideGridError, match="row 1 is of shape 2; there are 2, numbered"):
        estimate_static(prior, nodes, [], count=2).at(0.1, [1, 2])


def drawn_shapes(robot, nodes, count, places, loss=None):
    """Shapes of a robot's prior, and poses of one stream that are read at some nodes of each."""
    rng, std = np.random.default_rng(3), np.repeat([1e-3, 1e-2], 3)
    truth = sample_static(robot.prior, nodes, [], size=count, rng=rng)
    seen = truth.pose[:, places].reshape(-1, 4, 4)
    noise = std * rng.standard_normal((len(seen), 6))
    shape = np.repeat(np.arange(count), len(places))
    return truth.pose[:, -1, :3, 3], PoseReadings(
        time=shape, arclength=np.tile(nodes[places], count), name="bodies", cov=std**2,
        values=seen @ se3.exp(noise), loss=loss,
    )  # fmt: skip


def test_a_loss_that_saturates_throws_no_right_reading_away():
    """From rest it would those of every robot that is bent."""
    robot, count = load_robot("tdcr466"), 12
    nodes = robot.arclength_nodes
    tips, readings = drawn_shapes(robot, nodes, count, [2, 4], GemanMcClure())
    together = estimate_static(robot.prior, nodes, [readings])
    assert together.converged.all()
    off = together.at(robot.length, np.arange(count)).position - tips
    assert np.linalg.norm(off, axis=1).max() < 0.01
    for k, tip in enumerate(tips):
        one = alone(robot.prior, nodes, [readings], k).at(robot.length, 0.0)
        assert np.linalg.norm(one.position - tip) < 0.01


def test_a_reading_that_the_others_of_its_shape_refute_is_refused_and_named():
    robot, count, nodes = load_robot("tdcr466"), 4, np.linspace(0.0, 0.466, 13)
    tips, right = drawn_shapes(robot, nodes, count, np.arange(1, 13))
    values, row = right.values.copy(), 12 + 6
    values[row, :3, 3] += [0.03, 0.0, 0.0]
    wrong = right.changed(values=values)
    found = estimate_static(robot.prior, nodes, [wrong])
    assert found.refused == {"bodies": [row]}
    assert not estimate_static(robot.prior, nodes, [right]).refused
    off = found.at(robot.length, np.arange(count)).position - tips
    assert np.linalg.norm(off, axis=1).max() < 5e-3
    assert_same(found, alone(robot.prior, nodes, [wrong], 1), 1, np.array([0.05, 0.466]))


def test_shapes_whose_readings_contradict_them_are_named():
    rng, count = np.random.default_rng(0), 4
    bent = strains(rng, count, 1.0)
    places = np.tile(np.linspace(0.05, 0.4, 8), count)
    shape = np.repeat(np.arange(count), 8)
    values = bent[shape] + 0.01 * rng.standard_normal((shape.size, 6))
    values[shape % 2 == 1] += rng.standard_normal((16, 6))
    strain = StrainReadings(time=shape, arclength=places, values=values, cov=1e-4)
    with pytest.warns(FalseConfidenceWarning, match="^Shapes 1, 3 are in doubt") as warned:
        estimate_static(PRIORS["separable"], nodes_of("separable"), [strain])
    assert len(warned) == 1
