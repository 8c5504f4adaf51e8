"""Accelerometers: what they feel, slopes through every prior, tilt, confidence, online as batch."""

import numpy as np
import pytest
from test_inertia import GRID as SWING_GRID
from test_inertia import SWING, released, swinging, wire, wire_grid

from draws import motion, prior, sixes, states
from glissando import (
    AccelerometerReadings,
    FixedLagSmoother,
    PoseReadings,
    SensorParameter,
    SolverOptions,
    estimate,
)
from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.state import AcceleratedState
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from mechanical_rod import mechanical
from oracles import dense
from oracles import separable as oracle
from scenes import LENGTH, arc, sliding_scene
from slope import slope_test
from unknown_scenes import STEADY

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
GRAVITY = np.array([1.0, -2.0, -9.0])
PLACES = {  # arclength and time in numbers of nodes
    "node": ([1.0, 2.0, 3.0], [0.0, 1.0, 1.0]),
    "between arclengths": ([0.5, 1.2, 2.9], [0.0, 1.0, 1.0]),
    "between times": ([1.0, 2.0, 3.0], [0.7, 1.1, 1.6]),
    "cell": ([0.5, 1.2, 2.9], [0.7, 1.1, 1.6]),
}


def readings_at(arclength, time, values=None, **changes):
    count = np.size(time)
    fields = {"cov": 0.05**2, "gravity": GRAVITY, "name": "acc"}
    values = np.zeros((count, 3)) if values is None else values
    where = {"arclength": np.broadcast_to(arclength, count), "time": np.asarray(time)}
    return AccelerometerReadings(**where, values=values, **(fields | changes))


def test_the_residual_has_its_jacobian():
    rng = np.random.default_rng(0)
    at = states(rng, 9)
    at = AcceleratedState(
        at.pose, at.strain, at.velocity, acceleration=sixes(rng, 9, reach=5.0, angle=9.0)
    )
    mount = se3.exp(sixes(rng, reach=0.02))
    readings = readings_at(0.1, np.zeros(9), rng.standard_normal((9, 3)), mount=mount)
    slope_test(lambda step: readings.residual(at.retract(step)), readings.jacobian(at))


def test_a_sensor_off_the_backbone_feels_what_its_own_path_says():
    way, _ = released(0.1)
    mount, h = se3.exp(np.array([2e-3, -1e-3, 3e-3, 0.4, -0.2, 0.9])), 2e-4
    at = way.at(0.45, 0.05)
    early, here, late = (way.at(0.45, 0.05 + d).pose @ mount for d in (-h, 0.0, h))
    second = (early + late - 2.0 * here)[:3, 3] / h**2
    felt = here[:3, :3].T @ (second - GRAVITY)
    state = AcceleratedState(
        at.pose[None], np.zeros((1, 6)), at.velocity[None], acceleration=at.acceleration[None]
    )
    found = readings_at(0.45, [0.05], mount=mount).residual(state)[0]
    np.testing.assert_allclose(found, felt, atol=2e-3 * np.linalg.norm(felt))


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["white noise", "inertia"])
def test_readings_pull_on_the_nodes_as_their_jacobian_says(kind, place):
    rng = np.random.default_rng(1)
    if kind == "inertia":
        believed, grid = mechanical(inertia=SWING), SWING_GRID
        state = swinging(rng, believed)
        where = np.broadcast_to(grid.arclength, grid.shape)
        soft, ones = 0.1 / believed.rod.wrench(state.strain, where)[1], np.ones((*grid.shape, 6))
        scale = np.concatenate([ones, soft, ones, soft, ones], axis=-1)
    else:
        believed, grid, state = prior(), GRID, motion(rng, GRID)
        scale = np.ones((*grid.shape, state.dof))
    s, t = (
        np.interp(n, np.arange(nodes.size), nodes)
        for n, nodes in zip(PLACES[place], (grid.arclength, grid.time), strict=True)
    )
    readings = readings_at(s, t, mount=se3.exp(sixes(rng, reach=0.02)))
    located = locate(grid, [readings])
    ((*_, batch),) = measurement_factors(believed, located, state, state)

    def moved(step):
        there = state.retract(scale * step.reshape(scale.shape))
        ((*_, again),) = measurement_factors(believed, located, there, state)
        return again.terms.residual.ravel()

    spread = oracle.spread if kind == "inertia" else dense.spread
    jacobian = spread(batch, grid.shape[0] * grid.shape[1])
    slope_test(moved, jacobian.reshape(-1, scale.size) * scale.ravel())


def tilted(rng, bend, std=0.05):
    """What an accelerometer at the tip of an arc feels that does not move."""
    pose = se3.exp(LENGTH * np.array([0, 0, 1.0, bend, 0.4 * bend, 0.0]))
    time = np.linspace(0.0, 1.0, 21)
    felt = -pose[:3, :3].T @ GRAVITY + std * rng.standard_normal((time.size, 3))
    return pose, readings_at(LENGTH, time, felt, cov=std**2)


def test_at_rest_gravity_shows_the_tilt_as_surely_as_stated():
    _, grid, _ = sliding_scene()
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        pose, readings = tilted(rng, rng.uniform(-2.0, 2.0))
        base = PoseReadings(time=[0.0], arclength=[0.0], values=np.eye(4)[None], cov=1e-8)
        blind, found = (
            estimate(STEADY, grid, streams).at(LENGTH, 0.5)
            for streams in ([base], [base, readings])
        )
        turn = se3.so3_log(found.pose[:3, :3].T @ pose[:3, :3])
        cov = found.cov[3:6, 3:6]
        squares.append(turn @ np.linalg.solve(cov, turn))
        down = found.pose[:3, :3].T @ GRAVITY / np.linalg.norm(GRAVITY)
        across = np.linalg.svd(down[None])[2][1:]
        before, after = (np.trace(across @ c[3:6, 3:6] @ across.T) for c in (blind.cov, found.cov))
        assert after < 0.05 * before
    assert np.mean(squares) / 3.0 < 1.6  # it is stiller than it is believed to be


@pytest.mark.slow
def test_a_smoother_with_a_long_window_says_what_the_batch_says():
    believed, grid, (base, coil, _) = sliding_scene()
    time = np.arange(0.0, 1.001, 0.05)  # on time nodes and between them
    rng = np.random.default_rng(2)
    turn = arc(LENGTH, time)[:, :3, :3]
    felt = -np.einsum("mji,j->mi", turn, GRAVITY) + 0.05 * rng.standard_normal((time.size, 3))
    streams = [base, coil, readings_at(LENGTH, time, felt)]
    bias = [SensorParameter("zero", "bias", ("acc",), np.zeros(3), np.full(3, 0.1))]
    smoother = FixedLagSmoother(
        believed, grid.arclength, window=99, gate=None, sensor_parameters=bias
    )
    for i, until in enumerate(grid.time):
        since = grid.time[i - 1] if i else -1.0
        for r in streams:
            smoother.add(r.select((r.time > since) & (r.time <= until)))
        smoother.advance(float(until))
    gap = []
    exact = SolverOptions(tolerance=1e-6)
    batch = estimate(believed, grid, streams, sensor_parameters=bias, options=exact)
    for _ in range(2):  # before and after all is linearised again
        found = smoother.posterior()
        mine, its = (np.einsum("kii->ki", p.marginals.cov) ** 0.5 for p in (found, batch))
        gap.append(np.abs(mine / its - 1.0).max(axis=1))
        smoother.iterate()
    assert gap[0].max() < 0.03
    assert gap[1].max() < 1e-5


def test_what_cannot_be_is_one_sentence():
    with pytest.raises(SensorError, match=r"gravity is .* give three numbers in m/s²"):
        readings_at(0.1, [0.0], gravity=[0.0, 0.0, -9810.0])
    with pytest.raises(SensorError, match=r"span is .* give seconds"):
        readings_at(0.1, [0.0], span=[10.0])
    late = [SensorParameter("late", "time_offset", ("acc",), [0.0], [0.01])]
    with pytest.raises(SensorError, match="state offsets and lags of its stream as known"):
        estimate(prior(), GRID, [readings_at(0.1, [0.0, 0.1])], sensor_parameters=late)


def felt_by(way, s, rate, seconds, seed, std=0.05):
    time = np.arange(0.0, seconds + 1e-9, 1.0 / rate)
    force = way.at(s, time).specific_force
    force = force + std * np.random.default_rng(seed).standard_normal(force.shape)
    return readings_at(s, time, force, cov=std**2, gravity=np.zeros(3), name=f"at {s}")


@pytest.mark.slow
def test_beside_a_coil_it_shows_the_middle_of_a_swinging_rod_three_times_better():
    way, coil = released(0.5)
    grid, time, rmse = wire_grid(0.5), np.linspace(0.0, 0.5, 51), []
    truth = way.at(0.3, time).pose[:, :3, 3]
    for more in ([], [felt_by(way, 0.6, 100, 0.5, 5)]):
        found = estimate(wire(), grid, [coil, *more]).at(0.3, time)
        gap = found.position - truth
        nees = np.einsum("mi,mij,mj->m", gap, np.linalg.inv(found.cov_position_world), gap) / 3.0
        assert nees.mean() < 1.6
        rmse.append(np.sqrt(np.mean(gap**2)))
    assert max(rmse[1:]) < rmse[0] / 3.0
