import dataclasses
import warnings

import numpy as np
import pytest

from glissando import (
    BaseDensity,
    GemanMcClure,
    Huber,
    NotConvergedWarning,
    PoseReadings,
    SensorParameter,
    SolverOptions,
    State,
    estimate,
    load_robot,
    uniform_grid,
)
from glissando.errors import EstimateWarning, SensorError, UnobservableError
from glissando.geometry import se3
from scenes import LENGTH, arc, sliding_scene

TIGHT = SolverOptions(tolerance=1e-5, max_iterations=200)


def difference(a, b):
    """Largest difference of two posteriors: of the mean, and of the covariance relatively."""
    mean = np.abs(a.state.difference(b.state)).max()
    scale = np.sqrt(np.einsum("kii->ki", a.marginals.cov))
    cov = np.abs(a.marginals.cov - b.marginals.cov) / (scale[:, :, None] * scale[:, None, :])
    return mean, cov.max()


def test_any_roll_of_the_coil_changes_nothing():
    prior, grid, (base, coil, gyro) = sliding_scene()
    roll = np.zeros((len(coil), 6))
    roll[:, 5] = np.random.default_rng(1).uniform(-np.pi, np.pi, len(coil))
    rolled = dataclasses.replace(coil, values=coil.values @ se3.exp(roll))
    mean, cov = difference(
        estimate(prior, grid, [base, coil, gyro]), estimate(prior, grid, [base, rolled, gyro])
    )
    assert mean < 1e-9
    assert cov < 1e-9


def test_moving_the_world_frame_moves_the_answer_with_it():
    prior, grid, readings = sliding_scene()
    T_vw = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, -2.0, 0.7]))
    moved = [
        r if r.values.ndim == 2 else dataclasses.replace(r, values=T_vw @ r.values)
        for r in readings
    ]
    here = estimate(prior, grid, readings)
    there = estimate(dataclasses.replace(prior, base_pose=T_vw @ prior.base_pose), grid, moved)
    back = dataclasses.replace(
        there, state=dataclasses.replace(there.state, pose=se3.inverse(T_vw) @ there.state.pose)
    )
    mean, cov = difference(here, back)
    assert mean < 1e-9
    assert cov < 1e-9


def test_order_and_batching_of_readings_change_nothing():
    prior, grid, (base, coil, gyro) = sliding_scene()
    order = np.random.default_rng(2).permutation(len(coil))
    shuffled = coil.select(order)
    pieces = [shuffled.select(slice(0, 7)), gyro, shuffled.select(slice(7, None)), base]
    mean, cov = difference(estimate(prior, grid, [base, coil, gyro]), estimate(prior, grid, pieces))
    assert mean < 1e-9
    assert cov < 1e-9


def test_a_slid_sensor_leaves_less_uncertainty_than_a_fixed_one():
    prior, grid, (base, coil, gyro) = sliding_scene()
    at_tip = np.full(len(coil), LENGTH)
    fixed = dataclasses.replace(coil, arclength=at_tip, values=arc(at_tip, coil.time))
    swept = LENGTH * np.abs(np.cos(4 * coil.time))
    slid = dataclasses.replace(coil, arclength=swept, values=arc(swept, coil.time))
    std = [
        estimate(prior, grid, [base, c, gyro]).at(LENGTH / 2, grid.time).std_position
        for c in (fixed, slid)
    ]
    assert std[1].mean() < 0.8 * std[0].mean()


def test_adding_readings_never_raises_a_marginal_variance():
    prior, grid, (base, coil, gyro) = sliding_scene()
    start = estimate(prior, grid, [base, coil, gyro]).state
    once = SolverOptions(max_iterations=1, tolerance=np.inf)  # one linearisation point for both
    few = estimate(prior, grid, [base, gyro], initial=start, options=once)
    many = estimate(prior, grid, [base, gyro, coil], initial=start, options=once)
    ratio = np.einsum("kii->ki", many.marginals.cov) / np.einsum("kii->ki", few.marginals.cov)
    assert ratio.max() < 1 + 1e-9
    assert ratio.min() < 0.5


@pytest.fixture(scope="module")
def struck():
    """A coil with gross outliers: prior, grid, readings, how many, what measures, least squares.

    What measures gives the largest distance from the estimate that was spared them; the last is
    that of least squares.
    """
    prior, grid, (base, coil, gyro) = sliding_scene(duration=2.0)
    clean = estimate(prior, grid, [base, coil, gyro]).state
    values = coil.values.copy()
    hit = np.random.default_rng(3).choice(len(coil), len(coil) // 20, replace=False)
    values[hit] = values[hit] @ se3.exp(np.array([0.1, 0, 0, np.pi / 4, 0, 0]))
    spoilt = dataclasses.replace(coil, values=values)

    def off(posterior):
        return np.linalg.norm(posterior.state.difference(clean)[..., :3], axis=-1).max()

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotConvergedWarning)  # least squares may not even settle
        few = SolverOptions(max_iterations=30)
        plain = estimate(prior, grid, [base, spoilt, gyro], gate=None, options=few)
    return prior, grid, (base, spoilt, gyro), hit.size, off, off(plain)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [Huber(3.0), GemanMcClure(5.0)])
def test_a_robust_loss_shrugs_off_gross_outliers_and_counts_them(struck, loss):
    prior, grid, (base, spoilt, gyro), count, off, plain = struck
    robust = estimate(prior, grid, [base, dataclasses.replace(spoilt, loss=loss), gyro])
    assert robust.solve.converged
    assert robust.solve.suspects == count
    assert off(robust) < min(0.5 * plain, 2.4e-3)  # least squares found 9.6 mm or 3.4 mm


@pytest.mark.slow
def test_a_bad_start_converges_to_the_same_answer():
    prior, grid, readings = sliding_scene()
    good = estimate(prior, grid, readings, options=TIGHT)
    curled = np.array([0, 0, 1, -2, 1, 0.5])
    wrong = dataclasses.replace(prior, rest_strain=curled).rest_state(grid)
    again = estimate(prior, grid, readings, initial=wrong, options=TIGHT)
    assert again.solve.converged
    assert difference(good, again)[0] < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_starts_that_are_absurd_end_as_a_start_at_rest_does(seed):
    """Poses at random, and a robot wound by up to half a turn."""
    prior, grid, readings = sliding_scene()
    rng, rest = np.random.default_rng(seed), prior.rest_state(grid)
    good = estimate(prior, grid, readings)
    turn = rng.standard_normal(3)
    bend = np.zeros((*grid.shape, 18))
    bend[..., 9:12] = rng.uniform(0.5, 1.0) * np.pi * turn / np.linalg.norm(turn) / LENGTH
    for start in (
        rest.retract(rng.standard_normal((*grid.shape, 18))),
        prior.retract_strains(grid, rest, bend),
    ):
        found = estimate(prior, grid, readings, initial=start)
        assert found.solve.converged
        off = np.abs(found.state.difference(good.state)[..., :6])
        assert np.all(off < 0.1 * good.std_pose().max())


def test_an_estimate_that_does_not_converge_names_the_readings_that_do_not_fit():
    prior, grid, (base, coil, gyro) = sliding_scene()
    values = coil.values.copy()
    values[5, 0, 3] += 0.2
    off = dataclasses.replace(coil, values=values)
    options = SolverOptions(max_iterations=6, tolerance=1e-12)
    with pytest.warns(NotConvergedWarning, match=rf"do not fit: coil at {coil.time[5]:g} s \("):
        estimate(prior, grid, [base, off, gyro], options=options, gate=None)


def test_a_start_without_a_rate_that_the_prior_has_counts_as_at_rest():
    (_, grid, readings), prior = sliding_scene(nodes=5), load_robot("tdcr466-segments").prior
    start = prior.rest_state(grid)
    plain = State(start.pose, start.strain, start.velocity)
    found, good = (estimate(prior, grid, readings, initial=s) for s in (plain, start))
    assert start.strain_rate is not None
    np.testing.assert_array_equal(found.state.pose, good.state.pose)


def test_not_converging_is_never_silent():
    prior, grid, readings = sliding_scene()
    options = SolverOptions(max_iterations=1, tolerance=1e-6)
    with pytest.warns(NotConvergedWarning, match="not converged: 1 iterations.*Try"):
        posterior = estimate(prior, grid, readings, options=options)
    assert not posterior.solve.converged


def test_nothing_that_fixes_the_base_is_an_error():
    prior, grid, (_, _, gyro) = sliding_scene()
    with pytest.raises(UnobservableError, match="Nothing fixes the base"):
        estimate(dataclasses.replace(prior, base=None), grid, [gyro])


def test_a_roll_that_no_sensor_sees_is_an_error_not_a_number():
    prior, grid, (_, coil, _) = sliding_scene()
    straight = np.tile(np.eye(4), (len(coil), 1, 1))
    straight[:, 2, 3] = coil.arclength
    alone = dataclasses.replace(coil, values=straight)
    with pytest.raises(UnobservableError, match="singular"):
        estimate(dataclasses.replace(prior, base=None), grid, [alone])


def static_std(rate, arclength_nodes=5, per_node=False):
    """Lateral standard deviation (m) at mid-length of a static straight robot, tip and base seen.

    With `per_node` the densities are scaled as if every time node repeated the whole prior.
    """
    prior = load_robot("tdcr466").prior
    scale = 30.0 / rate if per_node else 1.0
    if per_node:
        prior = dataclasses.replace(
            prior,
            psd_strain_arclength=prior.psd_strain_arclength * scale,
            psd_velocity_arclength=prior.psd_velocity_arclength * scale,
            base=BaseDensity(*(scale * getattr(prior.base, f) for f in vars(prior.base))),
        )
    duration = 2.0
    grid = uniform_grid(LENGTH, arclength_nodes, 0.0, duration, rate)
    time = np.linspace(0.0, duration, 81)
    readings = []
    for place in (0.0, LENGTH):
        pose = np.tile(np.eye(4), (time.size, 1, 1))
        pose[:, 2, 3] = place
        cov = [2e-5] * 3 + [2.5e-3] * 3
        where = np.full(time.size, place)
        readings.append(PoseReadings(time=time, arclength=where, values=pose, cov=cov))
    found = estimate(prior, grid, readings).at(LENGTH / 2, duration / 2)
    return float(np.sqrt(found.cov[0, 0]))


def test_refining_time_does_not_repeat_the_prior_as_if_it_were_news():
    ours = static_std(30.0), static_std(60.0)
    published = static_std(30.0, per_node=True), static_std(60.0, per_node=True)
    print(f"static shape, mid-length std at 30 and 60 nodes/s: ours {ours}, per node {published}")
    assert ours[1] == pytest.approx(ours[0], rel=0.03)
    assert published[1] < 0.85 * published[0]


def test_refining_arclength_leaves_a_static_shape_alone():
    assert static_std(30.0, 9) == pytest.approx(static_std(30.0, 5), rel=0.03)


def test_progress_is_told_of_every_iteration():
    prior, grid, readings = sliding_scene()
    seen = []
    posterior = estimate(prior, grid, readings, progress=lambda *told: seen.append(told))
    assert [number for number, _, _ in seen] == list(range(1, posterior.solve.iterations + 1))
    assert posterior.solve.last_step == seen[-1][2]


@pytest.mark.parametrize("tolerance", [0.03, 0.3, 3.0])
def test_an_estimate_ends_within_the_tolerance_of_where_it_would_end(tolerance):
    prior, grid, readings = sliding_scene()
    ended, limit = (
        estimate(prior, grid, readings, options=SolverOptions(tolerance=t))
        for t in (tolerance, 1e-6)
    )
    off = ended.state.difference(limit.state).reshape(grid.time.size, -1)
    system = limit.system
    pulled = np.einsum("kij,kj->ki", system.diagonal, off)
    pulled[1:] += np.einsum("kij,kj->ki", system.lower, off[:-1])
    pulled[:-1] += np.einsum("kij,ki->kj", system.lower, off[1:])
    assert np.sqrt(np.sum(off * pulled)) < tolerance
    assert ended.solve.cost == pytest.approx(limit.solve.cost, abs=0.5 * tolerance**2)
    assert ended.log_evidence == pytest.approx(limit.log_evidence, abs=tolerance**2)


def test_a_warm_start_needs_fewer_iterations():
    prior, grid, readings = sliding_scene()
    cold = estimate(prior, grid, readings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warm = estimate(prior, grid, readings, initial=cold.state)
    assert warm.solve.iterations < cold.solve.iterations
    assert isinstance(warm.state, State)


def test_readings_that_are_given_twice_are_refused_as_they_would_count_twice():
    prior, grid, readings = sliding_scene()
    again = dataclasses.replace(readings[0], name="again")
    for twice in (readings[0], again):
        with pytest.raises(SensorError, match="the same readings, which would count twice"):
            estimate(prior, grid, [*readings, twice])


def test_sensor_parameters_of_streams_that_nobody_read_are_named():
    prior, grid, readings = sliding_scene()
    stray = SensorParameter("late", "time_offset", ("coyl",), [0.0], [0.01])
    with pytest.warns(EstimateWarning, match="of streams coyl, and the readings of"):
        estimate(prior, grid, readings, sensor_parameters=[stray])
