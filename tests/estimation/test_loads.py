"""Loads from a posterior: true within their covariance, the same on every grid and in any frame."""

import numpy as np
import pytest
from scipy.stats import chi2

from glissando import (
    CoilReadings,
    Grid,
    PoseReadings,
    SolverOptions,
    estimate,
    estimate_static,
    load_robot,
)
from glissando.errors import GlissandoError, OutsideGridError
from glissando.estimation import static
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Loads, Rod, Wrench, solve_shape

LENGTH, MIDDLE, COUNT = 0.6, 0.3, 40
GRAVITY = np.array([4.0, -3.0, -8.0])
ROD = Rod.of_tubes(LENGTH, [(1.6e-3, 0.0)], young=200e9, poisson=0.33, density=7870.0)
STD = np.repeat([0.08, 0.02], 3)
NODES = np.linspace(0.0, LENGTH, 9)
NOISE = np.repeat([0.7e-3, 7e-3], [3, 2])


def prior(**changes):
    """The prior of that rod under wrenches at its middle and at its tip."""
    fields = {
        "psd_load": np.repeat([1e-8, 1e-12], 3),
        "psd_strain_error": np.repeat([1e-11, 1e-7], 3),
        "var_tip": STD**2,
        "time_scale": 1.0,
        "var_base": np.full(6, 1e-10),
        "points": np.array([MIDDLE]),
        "var_points": STD[None] ** 2,
    }
    mechanics = Mechanics(ROD.stiffness[None], np.array([ROD.mass_per_length]), gravity=GRAVITY)
    return MechanicalPrior(mechanics, **(fields | changes))


@pytest.fixture(scope="module")
def drawn():
    """Wrenches (COUNT, 2, 6) in the world, and coil readings at four places of each shape."""
    rng = np.random.default_rng(1)
    loads = STD * rng.standard_normal((COUNT, 2, 6))
    places = np.array([0.18, 0.33, 0.47, LENGTH])
    poses = []
    for middle, tip in loads:
        ends = [Wrench(s, w[:3], w[3:]) for s, w in ((MIDDLE, middle), (LENGTH, tip))]
        shape = solve_shape(ROD, [], Loads(gravity=GRAVITY, wrenches=ends))
        off = np.zeros((places.size, 6))
        off[:, :5] = NOISE * rng.standard_normal((places.size, 5))
        poses.append(shape.at(places).pose @ se3.exp(off))
    time = np.repeat(np.arange(COUNT), places.size)
    return loads, CoilReadings(
        time=time,
        arclength=np.tile(places, COUNT),
        values=np.concatenate(poses),
        cov=NOISE**2,
    )


def nees(error, cov):
    return np.einsum("...i,...i->...", error, np.linalg.solve(cov, error[..., None])[..., 0])


@pytest.mark.slow
def test_wrenches_err_as_their_covariance_says_and_not_as_a_third_more_would(drawn):
    loads, coil = drawn
    found = estimate_static(prior(), NODES, [coil], count=COUNT)
    assert found.converged.all()
    low, high = chi2.ppf([0.005, 0.995], 12 * COUNT) / (12 * COUNT)
    total = 0.0
    for i, place in enumerate((MIDDLE, LENGTH)):
        load = found.load(place, np.arange(COUNT), frame="world")
        total += nees(load.wrench - loads[:, i], load.cov).sum()
    mean = total / (12 * COUNT)
    assert low < mean < high
    assert not low < 1.7 * mean < high
    assert not low < mean / 1.7 < high


@pytest.mark.slow
def test_more_nodes_change_no_standard_deviation_by_half_a_percent(drawn):
    coil = drawn[1].select(drawn[1].time < 6)
    stds = []
    for count in (5, 9, 25):
        found = estimate_static(prior(), np.linspace(0, LENGTH, count), [coil], count=6)
        load = found.load([[MIDDLE], [LENGTH]], np.arange(6))
        place = found.at([[0.1], [0.4], [0.6]], np.arange(6))
        stds.append(np.concatenate([load.std.ravel(), place.std_position.ravel()]))
    np.testing.assert_allclose(stds[0], stds[2], rtol=1e-2)
    np.testing.assert_allclose(stds[1], stds[2], rtol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("read", ["all", "tip"])
def test_of_a_rod_that_moves_neither_do_they(read):
    rng, times = np.random.default_rng(8), np.linspace(0.0, 0.4, 5)
    places, parts = np.array([0.18, 0.33, 0.47, LENGTH]), []
    for time in times:
        side = 0.2 * np.array([np.sin(5.0 * time), np.cos(3.0 * time), 0.0])
        shape = solve_shape(ROD, [], Loads(gravity=GRAVITY, wrenches=[Wrench(LENGTH, side)]))
        off = np.zeros((places.size, 6))
        off[:, :5] = NOISE * rng.standard_normal((places.size, 5))
        at = {"time": np.full(places.size, time), "arclength": places}
        parts.append(CoilReadings(**at, values=shape.at(places).pose @ se3.exp(off), cov=NOISE**2))
    if read == "tip":
        parts = [r.select(slice(-1, None)) for r in parts]
    none = {"points": np.zeros(0), "var_points": np.zeros((0, 6))}
    loose, stds = prior(var_tip=np.repeat([0.04, 1e-6], 3), time_scale=0.5, **none), []
    for count in (7, 15):
        grid = Grid(np.linspace(0.0, LENGTH, count), times)
        found = estimate(loose, grid, parts, gate=None, options=SolverOptions(tolerance=1e-3))
        assert found.solve.converged
        at = found.at([[0.1], [0.4], [0.6]], times[[1, 3]])
        inner = found.wrench([[0.1], [0.4]], times[[1, 3]])
        stds.append(np.concatenate([at.std_position.ravel(), inner.std.ravel(),
                                    found.load(LENGTH, times).std.ravel()]))  # fmt: skip
    np.testing.assert_allclose(stds[0], stds[1], rtol=5e-3)


def test_frames_agree_and_a_pose_that_is_unsure_blurs_the_worlds_axes(drawn):
    coil = drawn[1].select(drawn[1].time < 6)
    found = estimate_static(prior(), NODES, [coil], count=6)
    body, world = (found.load(LENGTH, np.arange(6), frame=frame) for frame in ("body", "world"))
    turn = found.state.pose[:, -1, :3, :3]
    np.testing.assert_allclose(np.einsum("kij,kj->ki", turn, body.force), world.force, atol=1e-12)
    assert np.all(
        np.trace(world.cov, axis1=1, axis2=2) > 0.9 * np.trace(body.cov, axis1=1, axis2=2)
    )
    inner = found.wrench(LENGTH, np.arange(6))  # nothing else acts at the tip
    np.testing.assert_allclose(inner.wrench, body.wrench, atol=1e-9)
    np.testing.assert_allclose(inner.cov, body.cov, rtol=1e-6, atol=1e-12)


def test_a_moment_of_a_recording_says_what_a_static_shape_does_without_curvature(
    drawn, monkeypatch
):
    monkeypatch.setattr(static, "with_curvature", lambda here, added: here.system)
    coil = drawn[1].select(drawn[1].time == 0)
    one = estimate(prior(), Grid(NODES, [0.0]), [coil])
    many = estimate_static(prior(), NODES, [coil], count=1)
    for place in (MIDDLE, LENGTH):
        a, b = one.load(place, 0.0), many.load(place, 0)
        np.testing.assert_allclose(a.std, b.std, rtol=2e-2)
        assert np.all(np.abs(a.wrench - b.wrench) < 0.2 * a.std)


def test_a_load_that_lasts_is_found_over_time_and_between_nodes(drawn):
    coil = drawn[1]
    first = coil.select(coil.time == 0)
    times = np.repeat(np.linspace(0.0, 0.5, 6), len(first))
    still = first.changed(
        time=times,
        arclength=np.tile(first.arclength, 6),
        values=np.tile(first.values, (6, 1, 1)),
    )
    found = estimate(prior(), Grid(NODES, np.linspace(0.0, 0.5, 6)), [still])
    once = estimate(prior(), Grid(NODES, [0.0]), [first])
    load = found.load(LENGTH, 0.3)
    assert np.all(load.std < once.load(LENGTH, 0.0).std)
    between = found.wrench([0.13, 0.44], [0.23, 0.37])
    assert np.all(np.isfinite(between.cov))
    assert np.all(np.linalg.eigvalsh(between.cov) > 0.0)


def test_without_a_load_anywhere_nothing_is_found():
    still = solve_shape(ROD, [], Loads(gravity=GRAVITY)).at(np.array([LENGTH]))
    tip = PoseReadings(time=[0.0], arclength=[LENGTH], values=still.pose, cov=1e-8)
    found = estimate(prior(), Grid(NODES, [0.0]), [tip])
    assert np.all(np.abs(found.load(LENGTH, 0.0).wrench) < 1e-3)


def test_mistakes_are_one_sentence(drawn):
    coil = drawn[1].select(drawn[1].time == 0)
    found = estimate_static(prior(), NODES, [coil], count=1)
    with pytest.raises(OutsideGridError, match="No load is expected at"):
        found.load(0.2, 0)
    with pytest.raises(GlissandoError, match="frame 'tip'"):
        found.wrench(0.2, 0, frame="tip")
    robot = load_robot("tdcr466-segments")
    other = estimate_static(robot.prior, robot.arclength_nodes, [], count=1)
    with pytest.raises(GlissandoError, match="what the robot is made of"):
        other.load(robot.length, 0)


def test_standard_deviations_are_those_of_loads_through_another_solver(drawn):
    """Least squares over the loads alone, shapes by shooting: curvature of readings is small."""
    coil = drawn[1].select(drawn[1].time < 3)
    found = estimate_static(prior(), NODES, [coil], count=3)
    std = np.concatenate([found.load(s, np.arange(3), frame="world").std for s in (MIDDLE, LENGTH)],
                         axis=1)  # fmt: skip
    for k in range(3):
        own = coil.select(coil.time == k)

        def readings(wrench, places=own.arclength):
            ends = [
                Wrench(s, w[:3], w[3:]) for s, w in ((MIDDLE, wrench[:6]), (LENGTH, wrench[6:]))
            ]
            return solve_shape(ROD, [], Loads(gravity=GRAVITY, wrenches=ends)).at(places).pose

        mean = np.concatenate(
            [found.load(s, k, frame="world").wrench.ravel() for s in (MIDDLE, LENGTH)]
        )
        steps = 1e-3 * np.tile(STD, 2) * np.eye(12)
        slope = [
            se3.log(se3.inverse(readings(mean - step)) @ readings(mean + step))[:, :5].ravel()
            / (2.0 * step.sum() * np.tile(NOISE, len(own)))
            for step in steps
        ]
        information = np.array(slope) @ np.array(slope).T + np.diag(np.tile(STD, 2) ** -2.0)
        least = np.sqrt(np.diag(np.linalg.inv(information)))
        np.testing.assert_allclose(std[k], least, rtol=0.04)
