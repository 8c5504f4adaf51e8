"""Assembly against the dense twin, and what must not matter to it: order, batches, blocks."""

import numpy as np
import pytest

from draws import motion, prior
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.sensors import CoilReadings, GyroReadings, PositionReadings
from glissando.model.state import DOF
from glissando.solver import located_readings
from glissando.solver.block_tridiagonal import factor
from glissando.solver.linearize import gradient, linearize
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import system_shape
from oracles import dense

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25, 0.3])
K, N = GRID.shape
STATE = motion(np.random.default_rng(60), GRID)
ABOUT = motion(np.random.default_rng(61), GRID)


def scattered(rng, count, *, loss=None):
    """Readings on nodes, on lines and in cells, several to a cell, and some wildly wrong."""
    s, t = rng.uniform(0.0, 0.4, count), rng.uniform(0.0, 0.3, count)
    s[::3], t[1::3] = rng.choice(GRID.arclength, s[::3].size), rng.choice(GRID.time, t[1::3].size)
    s[::5], t[::5] = rng.choice(GRID.arclength, s[::5].size), rng.choice(GRID.time, t[::5].size)
    where, cov = {"time": t, "arclength": s}, rng.uniform(1e-3, 1e-2, (count, 1, 1))
    roll = np.zeros((count, 6))
    roll[:, 5] = rng.uniform(-np.pi, np.pi, count)
    mount = se3.exp(np.array([0.0, 0.01, 0.0, 0.1, 0.2, 0.3]))
    return [
        CoilReadings(**where, values=se3.exp(roll), cov=cov * np.eye(5), mount=mount, loss=loss),
        GyroReadings(**where, values=rng.standard_normal((count, 3)), cov=1e-2, loss=loss),
        PositionReadings(**where, values=rng.standard_normal((count, 3)), cov=1e-2),
    ]


def equations(readings, *, state=STATE, about=ABOUT, held=None):
    workspace = np.empty(system_shape(K, N * DOF))
    return linearize(prior(), locate(GRID, readings), state, about, workspace, held)


def same(one, other, tolerance=1e-12):
    matrices = dense.matrix_of(one.system), dense.matrix_of(other.system)
    for a, b in (matrices, (one.rhs, other.rhs)):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance * np.abs(b).max())


@pytest.mark.parametrize("loss", [None, Huber(1.0), GemanMcClure(1.0)], ids=str)
def test_the_slabs_hold_what_dense_assembly_finds(loss):
    readings = scattered(np.random.default_rng(62), 60, loss=loss)
    found = equations(readings)
    located = locate(GRID, readings)
    batches = [*prior().factors(GRID, STATE, ABOUT, slice(0, K))]
    batches += [b for *_, b in measurement_factors(prior(), located, STATE, ABOUT)]
    assert sum(len(b.nodes) for b in batches[5:]) == 180
    expected = dense.assemble(batches, K * N)
    scale = np.abs(expected.information).max()
    matrix = dense.matrix_of(found.system)
    np.testing.assert_allclose(matrix, expected.information, atol=1e-12 * scale)
    np.testing.assert_allclose(found.rhs.ravel(), expected.right, atol=1e-9)

    chol = factor(found.system)
    assert chol.log_det == pytest.approx(expected.log_det, abs=1e-6)
    step = chol.solve(found.rhs).ravel()
    std = np.sqrt(np.diagonal(expected.cov))
    np.testing.assert_allclose(step / std, expected.step / std, atol=1e-6)
    found_std = np.sqrt(np.einsum("kii->ki", chol.marginals().cov)).ravel()
    np.testing.assert_allclose(found_std, std, rtol=1e-6)


@pytest.mark.parametrize("loss", [None, Huber(1.0), GemanMcClure(1.0)], ids=str)
def test_the_right_hand_side_is_the_downhill_slope_of_the_cost(loss):
    readings = scattered(np.random.default_rng(63), 20, loss=loss)
    here = equations(readings)
    rng = np.random.default_rng(64)
    for _ in range(5):
        way = rng.standard_normal((K, N, DOF)) / 10.0
        uphill, downhill = (
            here.cost_of(equations(readings, state=STATE.retract(h * way), held=here.terms))
            for h in (1e-5, -1e-5)
        )
        slope = (uphill - downhill) / 2e-5
        assert -np.sum(here.rhs * way.reshape(K, -1)) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("correlation_time", [np.inf, 0.1])
def test_the_gradient_is_the_right_hand_side_without_the_system(correlation_time):
    rng = np.random.default_rng(67)
    readings = scattered(rng, 40, loss=Huber(1.0))
    zero, std = np.zeros(6), np.full(6, 0.01)
    names = (readings[0].name,)
    kept = {"correlation_time": correlation_time}
    offsets = [SensorParameter("mount", "mount", names, zero, std, **kept)]
    for grid in (GRID, Grid(GRID.arclength, [0.0])):
        state = motion(rng, grid)
        inside = [r.inside(grid) for r in readings]
        located = locate(grid, inside, offsets)
        located = located.moved(0.01 * rng.standard_normal(located.parameters.values.shape))
        shape = system_shape(grid.time.size, N * DOF + 6)
        whole = linearize(prior(), located, state, state, np.empty(shape))
        scale = np.abs(whole.rhs).max()
        found = gradient(prior(), located, state, state)
        np.testing.assert_allclose(found, whole.rhs, atol=1e-12 * scale)


def test_fixed_weights_are_those_of_where_they_were_found():
    readings = scattered(np.random.default_rng(65), 20)
    here = equations(readings)
    there = equations(readings, about=STATE, held=here.terms)
    for old, new in zip(here.terms, there.terms, strict=True):
        np.testing.assert_array_equal(old.sqrt_info, new.sqrt_info)


def test_the_order_of_readings_does_not_matter():
    readings = scattered(np.random.default_rng(66), 30)
    shuffle = np.random.default_rng(67).permutation(30)
    same(equations([r.select(shuffle) for r in reversed(readings)]), equations(readings))


def test_a_batch_may_be_split():
    readings = scattered(np.random.default_rng(68), 30)
    halves = [r.select(slice(i, None, 2)) for r in readings for i in (0, 1)]
    same(equations(halves), equations(readings))


def test_readings_of_nothing_are_nothing():
    readings = scattered(np.random.default_rng(69), 6)
    none = [r.select(slice(0, 0)) for r in readings]
    same(equations(none), equations([]), 0.0)
    same(equations(readings + none), equations(readings), 0.0)


@pytest.mark.parametrize("most", [1, 4, 9])
def test_how_time_is_cut_into_blocks_does_not_matter(monkeypatch, most):
    readings = scattered(np.random.default_rng(70), 30)
    whole = equations(readings)
    monkeypatch.setattr(located_readings, "_FACTORS", most)
    assert len(locate(GRID, readings).blocks) > 1
    same(equations(readings), whole)


def test_the_bridge_widens_a_readings_covariance_only_between_nodes():
    s, t = np.array([0.1, 0.17]), np.array([0.1, 0.1])
    where = {"time": t, "arclength": s}
    reading = PositionReadings(**where, values=np.zeros((2, 3)), cov=1e-6)
    located = locate(GRID, [reading])
    found = measurement_factors(prior(), located, STATE, ABOUT)
    on_node, between_nodes = (batch for *_, batch in found)
    np.testing.assert_allclose(on_node.terms.sqrt_info[0], 1e3 * np.eye(3), rtol=1e-12, atol=1e-9)
    root = np.linalg.inv(between_nodes.terms.sqrt_info[0])
    assert np.linalg.eigvalsh(root @ root.T - 1e-6 * np.eye(3))[0] > 0.0


@pytest.mark.parametrize("memory", [np.inf, 0.1])
def test_steps_are_damped_by_what_is_read_of_a_sensor_parameter_not_by_how_little_it_drifts(memory):
    """By the whole diagonal, which ties it from time to time, any damping would hold a constant."""
    readings = scattered(np.random.default_rng(68), 40, loss=Huber(1.0))
    std, kept = np.full(6, 0.01), {"correlation_time": memory}
    mount = SensorParameter("mount", "mount", (readings[0].name,), np.zeros(6), std, **kept)
    located = locate(GRID, readings, [mount])
    here = linearize(prior(), located, STATE, ABOUT, np.empty(system_shape(K, N * DOF + 6)))
    read = np.zeros((K, 6))
    for _, _, batch in measurement_factors(prior(), located, STATE, ABOUT):
        if batch.extras is not None:
            weights = batch.terms.robust_weights()[:, None]
            white = (batch.terms.sqrt_info @ batch.extras) ** 2
            first = np.minimum(batch.nodes[:, 0] // N, K - 2)
            np.add.at(read, first, weights * np.sum(white[..., :6], axis=1))
            np.add.at(read, first + 1, weights * np.sum(white[..., 6:], axis=1))
    diagonal, own = np.einsum("kii->ki", here.system.diagonal), slice(N * DOF, None)
    np.testing.assert_array_equal(here.scale[:, : N * DOF], diagonal[:, : N * DOF])
    np.testing.assert_allclose(here.scale[:, own], np.maximum(read, std**-2.0 / K), rtol=1e-3)
    if memory == np.inf:
        assert np.all(diagonal[:, own] > 1e4 * std**-2.0)
