"""Every analytic derivative in the package against the slope test; sensors found by discovery."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from draws import motion, poses, prior, sixes, spd, states
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.priors.steps import ARCLENGTH, TIME
from glissando.model.sensors import sensors
from glissando.model.sensors.numerical_jacobian import numerical_jacobian
from glissando.model.state import DOF, State
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from oracles import dense
from oracles.steps import between, built, carried_error, pair_error
from oracles.transitions import Bridge
from slope import PLACES, interpolation_slope_test, slope_test

M = 12
GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
NODES = 12


def seen_from(rng, pose, angle=1.0):
    """Poses that a sensor might have reported instead of these."""
    return pose @ se3.exp(sixes(rng, len(pose), reach=0.05, angle=angle))


def any_roll(rng, count):
    roll = np.zeros((count, 6))
    roll[:, 5] = rng.uniform(-np.pi, np.pi, count)
    return se3.exp(roll)


BUILDERS = {
    sensors.PoseReadings: lambda rng, at, T_bc: {"values": seen_from(rng, at.pose @ T_bc)},
    sensors.CoilReadings: lambda rng, at, T_bc: {
        "values": seen_from(rng, at.pose @ T_bc) @ any_roll(rng, M)
    },
    sensors.PositionReadings: lambda rng, at, T_bc: {"values": rng.standard_normal((M, 3))},
    sensors.OrientationReadings: lambda rng, at, T_bc: {
        "values": seen_from(rng, at.pose @ T_bc, angle=2.0)[:, :3, :3]
    },
    sensors.GyroReadings: lambda rng, at, T_bc: {"values": rng.standard_normal((M, 3))},
    sensors.StrainReadings: lambda rng, at, T_bc: {"values": rng.standard_normal((M, 6))},
    sensors.FbgReadings: lambda rng, at, T_bc: {
        "values": 1e-3 * rng.standard_normal((M, 4)),
        "core_radius": np.array([0.0, 2e-2, 3e-2, 4e-2]),
        "core_angle": np.array([0.0, 0.3, 2.0, 4.5]),
    },
}


def shipped_sensors(parent=sensors.Readings):
    """Every sensor class of the package, however deep."""
    for child in parent.__subclasses__():
        if child.__module__ == sensors.__name__ and not child.__name__.startswith("_"):
            yield child
        yield from shipped_sensors(child)


SENSORS = sorted(set(shipped_sensors()), key=lambda sensor: sensor.__name__)


def readings_of(sensor, rng, at, **where):
    """M readings of a sensor, taken near the states `at`."""
    build = BUILDERS.get(sensor)
    if build is None:
        pytest.fail(f"{sensor.__name__} has no builder here; give it one, so its slope is tested.")
    mount = poses(rng, reach=0.02)
    place = {"time": np.zeros(M), "arclength": np.zeros(M), **where}
    mounted = {"mount": mount} if sensor.mounted else {}
    return sensor(**place, **build(rng, at, mount), **mounted, cov=1e-4)


def test_discovery_finds_the_sensors():
    assert set(BUILDERS) <= set(SENSORS)


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensors_jacobian_is_the_slope_of_its_residual(sensor):
    rng = np.random.default_rng(10)
    at = states(rng, M)
    readings = readings_of(sensor, rng, at)
    slope_test(lambda step: readings.residual(at.retract(step)), readings.jacobian(at))


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensors_jacobian_equals_the_numerical_one(sensor):
    rng = np.random.default_rng(11)
    at = states(rng, M)
    readings = readings_of(sensor, rng, at)
    numerical = numerical_jacobian(readings, at)
    np.testing.assert_allclose(readings.jacobian(at), numerical, rtol=0.0, atol=1e-8)


def neighbours(rng, direction):
    """Both ends of steps, the second near where the first one's rate leads."""
    start, step = states(rng, M), rng.uniform(0.05, 0.3, M)
    ahead = start.pose @ se3.exp(step[:, None] * direction.rate_of(start))
    end = built(direction, ahead, direction.rate_of(start), direction.carried_of(start))
    return start, end.retract(0.2 * rng.standard_normal((M, DOF))), step


@pytest.mark.parametrize("direction", [ARCLENGTH, TIME], ids=lambda d: d.name)
@pytest.mark.parametrize("name", ["pair", "carried"])
def test_a_steps_errors_have_their_jacobians(direction, name):
    start, end, step = neighbours(np.random.default_rng(12), direction)

    def error(first, second):
        if name == "pair":
            return pair_error(direction, first, second, step)
        return carried_error(direction, first, second)

    def moved(both):
        return error(start.retract(both[:, :DOF]), end.retract(both[:, DOF:]))[0]

    slope_test(moved, np.concatenate(error(start, end)[1:], axis=-1))


def any_bridge(rng):
    """A bridge of no particular process."""
    gain, carried_gain = rng.standard_normal((M, 12, 12)), rng.standard_normal((M, 6, 6))
    cov, carried_cov = spd(rng, M, size=12), spd(rng, M, size=6)
    return Bridge(0.3 * gain, cov, 0.3 * carried_gain, carried_cov)


@pytest.mark.parametrize("direction", [ARCLENGTH, TIME], ids=lambda d: d.name)
def test_the_point_between_two_nodes_has_its_jacobians(direction):
    rng = np.random.default_rng(13)
    start, end, step = neighbours(rng, direction)
    offset, bridge = step * rng.uniform(size=M), any_bridge(rng)

    def moved(both):
        ends = start.retract(both[:, :DOF]), end.retract(both[:, DOF:])
        return between(direction, *ends, step, offset, bridge)[0]

    _, j0, j1, _ = between(direction, start, end, step, offset, bridge)
    slope_test(moved, np.concatenate([j0, j1], axis=-1), difference=State.difference)


@pytest.mark.parametrize("direction", [ARCLENGTH, TIME], ids=lambda d: d.name)
def test_bridge_covariance_is_carried_into_the_frame_of_the_point(direction):
    rng = np.random.default_rng(14)
    start, end, step = neighbours(rng, direction)
    offset, bridge = step * rng.uniform(size=M), any_bridge(rng)
    pair = pair_error(direction, start, end, step)[0]
    carried = carried_error(direction, start, end)[0]

    def disturbed(noise):
        """The point when bridge noise (M, 18) is added to what the gains make of the errors."""

        def push(gain, extra, error):
            return gain + extra[:, :, None] * (error / np.sum(error**2, axis=-1)[:, None])[:, None]

        gain = push(bridge.gain, noise[:, :12], pair)
        carried_gain = push(bridge.carried_gain, noise[:, 12:], carried)
        noisy = Bridge(gain, bridge.cov, carried_gain, bridge.carried_cov)
        return between(direction, start, end, step, offset, noisy)[0]

    tiny = 1e-6
    columns = [
        disturbed(np.tile(h, (M, 1))).rise_from(disturbed(np.tile(-h, (M, 1)))) / (2 * tiny)
        for h in tiny * np.eye(DOF)
    ]
    into_frame = np.stack(columns, axis=-1)
    found = between(direction, start, end, step, offset, bridge)[3]
    for row in range(M):
        noise = block_diag(bridge.cov[row], bridge.carried_cov[row])
        expected = into_frame[row] @ noise @ into_frame[row].T
        np.testing.assert_allclose(found[row], expected, atol=1e-6 * np.abs(expected).max())


def batches_of_prior(prior_, state, about):
    return list(prior_.factors(GRID, state, about, slice(0, GRID.time.size)))


def test_every_prior_factor_has_its_jacobian_and_names_its_nodes():
    rng = np.random.default_rng(15)
    state = motion(rng, GRID)
    soft = prior(base_pose=state.pose[0, 0] @ se3.exp(sixes(rng, reach=0.1)))
    batches = batches_of_prior(soft, state, state)
    assert len(batches) == 5  # pair and carried, along arclength and time, and the base
    for i, batch in enumerate(batches):

        def moved(step, i=i):
            there = state.retract(step.reshape(*GRID.shape, DOF))
            return batches_of_prior(soft, there, state)[i].terms.residual.ravel()

        jacobian = dense.spread(batch, NODES)
        slope_test(moved, jacobian.reshape(-1, jacobian.shape[-1]))


@pytest.mark.parametrize("place", PLACES)
def test_interpolation_has_its_jacobian_and_names_its_nodes(place):
    interpolation_slope_test(prior(), GRID, motion(np.random.default_rng(16), GRID), place)


@pytest.mark.parametrize("sensor", SENSORS)
def test_readings_inside_cells_pull_on_the_nodes_as_their_jacobian_says(sensor):
    rng = np.random.default_rng(17)
    state = motion(rng, GRID)
    where = {"arclength": rng.uniform(0.0, 0.4, M), "time": rng.uniform(0.0, 0.25, M)}
    (points,) = sort_points(GRID, where["arclength"], where["time"])
    at = prior().interpolate(GRID, state, state, points).state
    located = locate(GRID, [readings_of(sensor, rng, at, **where)])
    ((*_, batch),) = measurement_factors(prior(), located, state, state)

    def moved(step):
        there = state.retract(step.reshape(*GRID.shape, DOF))
        ((*_, again),) = measurement_factors(prior(), located, there, state)
        return again.terms.residual.ravel()

    jacobian = dense.spread(batch, NODES)
    slope_test(moved, jacobian.reshape(-1, jacobian.shape[-1]))
