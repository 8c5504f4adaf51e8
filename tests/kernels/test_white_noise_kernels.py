"""What kernels make of a window at once is what prior and sensors say factor by factor."""

from dataclasses import replace

import numpy as np
import pytest

import oracles.factors
import oracles.white_noise
from draws import motion, prior
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.noise import GemanMcClure, Huber
from glissando.model.sensors.compiled_readings import ReadingRows, is_compiled
from glissando.model.sensors.sensors import FbgReadings, PoseReadings, sensor_class
from glissando.model.state import DOF, State
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25, 0.3], before=-0.1)
KINDS = ("pose", "coil", "position", "orientation", "gyro", "strain")


def jointed(rng):
    """A prior of two segments, with a base that is not where the robot is."""
    densities = rng.uniform(0.5, 2.0, (2, 6))
    jumps = rng.uniform(0.1, 0.5, (1, 6))
    about = se3.exp(0.1 * rng.standard_normal(6))
    segments = {"psd_strain_arclength": densities, "joints": np.array([0.25]), "jumps": jumps}
    return prior(base_pose=about, **segments, pace=np.array([1.0, 0.1]), pace_times=GRID.time[2:3])


def readings_of(rng, kind, **options):
    """Readings on nodes, on grid lines and inside cells, of a sensor that sits askew."""
    sensor = sensor_class(kind)
    place = rng.choice([0.0, 0.03, 0.1, 0.33, 0.4], 12)
    time = rng.choice([0.0, 0.05, 0.1, 0.28, 0.3], 12)
    values = rng.standard_normal((12, *(sensor.value_shape or ())))
    if values.ndim == 3:
        n = values.shape[1]
        values = se3.exp(rng.standard_normal((12, 6)))[:, :n, :n]
    root = rng.standard_normal((12, sensor.rows, sensor.rows))
    cov = root @ np.swapaxes(root, 1, 2) + np.eye(sensor.rows)
    mount = se3.exp(0.3 * rng.standard_normal(6)) if sensor.mounted else np.eye(4)
    return sensor(time=time, arclength=place, values=values, cov=cov, mount=mount, **options)


def densities(believed):
    """Densities of the steps between the nodes of the grid."""
    return believed.arclength_densities(GRID.arclength), believed.time_densities(GRID.time)


def none():
    """No readings, as kernels take them."""
    return *ReadingRows().memory, np.zeros(0, dtype=np.intp)


def sums_of(grid):
    size, (k, n) = DOF, grid.shape
    blocks = [np.empty((count, n * size, n * size)) for count in (k, k, k - 1)]
    return NormalEquationsBuilder(Layout(n, size), *blocks, *np.empty((2, k, n * size)))


def same(found, expected, tolerance=1e-12):
    scale = 1.0 + np.abs(expected).max(initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * scale)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_reads_what_its_definition_says(kind):
    rng = np.random.default_rng(3)
    readings = readings_of(rng, kind)
    at = State(se3.exp(rng.standard_normal((12, 6))), *rng.standard_normal((2, 12, 6)))
    expected = oracles.factors.sense(kind, readings.values, readings.mount, at)
    same(readings.residual(at), expected[0])
    same(readings.jacobian(at), expected[1], 1e-9)


@pytest.mark.parametrize("firm", [True, False])
def test_the_sums_of_the_prior_are_those_of_its_factors(firm):
    rng = np.random.default_rng(4)
    believed, state = jointed(rng), motion(rng, GRID)
    believed = believed if firm else replace(believed, base=None)
    one, each = sums_of(GRID), sums_of(GRID)
    believed.accumulate(GRID, state, densities(believed), none(), one.sums)
    for batch in believed.factors(GRID, state, state, slice(0, 4)):
        each.accumulate(batch)
    for mine, its in zip(one.sums, each.sums, strict=True):
        same(mine, its)


def test_points_between_nodes_are_those_of_the_bridges():
    rng = np.random.default_rng(5)
    believed, state, about = jointed(rng), motion(rng, GRID), motion(rng, GRID)
    s, t = np.meshgrid([0.0, 0.04, 0.25, 0.4], [0.0, 0.07, 0.25, 0.3])
    for points in sort_points(GRID, s.ravel(), t.ravel()):
        found = believed.interpolate(GRID, state, about, points)
        expected = oracles.white_noise.interpolate(believed, GRID, state, about, points)
        np.testing.assert_array_equal(found.nodes, expected.nodes)
        for mine, its in zip(found.state.fields(), expected.state.fields(), strict=True):
            same(mine, its)
        same(found.jacobian, expected.jacobian)
        same(found.cov, expected.cov)


@pytest.mark.parametrize("loss", [None, Huber(1.5), GemanMcClure(2.0)])
@pytest.mark.parametrize("kind", KINDS)
def test_readings_taken_together_weigh_what_each_stream_does(kind, loss):
    rng = np.random.default_rng(6)
    believed, state, readings = jointed(rng), motion(rng, GRID), readings_of(rng, kind, loss=loss)
    rows, one, each = ReadingRows(), sums_of(GRID), sums_of(GRID)
    rows.append(7, readings_of(rng, "gyro"))  # which is not asked for
    rows.append(3, readings)
    memory = *rows.memory, np.arange(12, 24)
    believed.accumulate(GRID, state, densities(believed), memory, one.sums)
    for batch in believed.factors(GRID, state, state, slice(0, 4)):
        each.accumulate(batch)
    for _, _, batch in measurement_factors(believed, locate(GRID, [readings]), state, state):
        each.accumulate(batch)
    for mine, its in zip(one.sums, each.sums, strict=True):
        same(mine, its)


def test_a_sensor_with_a_residual_of_its_own_is_left_to_it():
    class Scaled(PoseReadings):
        def residual(self, at):
            return 2.0 * super().residual(at)

    at = {"time": np.zeros(1), "arclength": np.zeros(1)}
    cores = {"core_radius": np.zeros(1), "core_angle": np.zeros(1)}
    assert is_compiled(PoseReadings(**at, values=np.eye(4)[None], cov=1.0))
    assert not is_compiled(Scaled(**at, values=np.eye(4)[None], cov=1.0))
    assert not is_compiled(FbgReadings(**at, values=np.zeros((1, 1)), cov=1.0, **cores))
    unsure = PoseReadings(**at, values=np.eye(4)[None], cov=1.0, arclength_std=1e-3)
    assert not is_compiled(unsure)


def test_rows_keep_their_order_when_some_go_and_memory_grows():
    rng = np.random.default_rng(8)
    rows, parts = ReadingRows(), [readings_of(rng, "gyro") for _ in range(9)]
    for number, part in enumerate(parts):
        rows.old = rows.count
        rows.append(number, part)
    time, stream = np.concatenate([part.time for part in parts]), np.repeat(np.arange(9), 12)
    kept = time > 0.06
    rows.keep(kept)
    np.testing.assert_array_equal(rows.time, time[kept])
    np.testing.assert_array_equal(rows.stream[: rows.count], stream[kept])
    assert rows.old == np.count_nonzero(kept[:96])
