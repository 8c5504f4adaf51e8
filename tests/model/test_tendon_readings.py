"""Displacements of tendons read the whole robot at one time, and pull on all of its nodes."""

import numpy as np
import pytest
from scipy.stats import chi2

from glissando.errors import FalseConfidenceWarning, SensorError
from glissando.estimation.batch import estimate
from glissando.estimation.static import estimate_static
from glissando.geometry import se3
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording
from glissando.model.grid import Grid
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.sensors import PoseReadings
from glissando.model.sensors.tendons import TendonReadings, up_to
from glissando.model.state import State
from glissando.model.tendons.channel import Channel
from glissando.simulation import Loads, solve_shape
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from mechanical_rod import moving
from slope import slope_test
from tendon_robot import ENDS, LENGTH, simulated, tendon_robot

NODES = np.linspace(0.0, LENGTH, 5)
GRID = Grid(NODES, [0.0, 0.5, 1.0])
CHANNELS = {"radius": [0.0045, 0.004, 0.0045], "angle": [0.0, 2.1, 4.0], "end": [0.2, 0.2, 0.08]}


def readings(time, values, **more):
    settings = {name: np.array(value) for name, value in CHANNELS.items()}
    place = np.full(len(time), LENGTH)
    given = {"time": np.asarray(time), "arclength": place, "values": np.asarray(values)}
    return TendonReadings(**given, cov=1e-10, **(settings | {"name": "pull"} | more))


@pytest.mark.parametrize("end", [0.2, 0.13, 0.04])
def test_weights_integrate_a_line_between_nodes(end):
    rng = np.random.default_rng(0)
    nodes = np.sort(np.r_[0.0, rng.uniform(0.0, 0.2, 5), 0.2])
    values = rng.standard_normal(nodes.size)
    fine = np.linspace(0.0, end, 200_001)
    expected = np.trapezoid(np.interp(fine, nodes, values), fine)
    assert up_to(nodes, end) @ values == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("time", [[0.5, 0.5], [0.2, 0.7]])
@pytest.mark.parametrize("more", [{}, {"pitch": np.array([0.3, 0.2, 0.0])}])
def test_readings_pull_on_all_nodes_of_their_time_as_their_jacobian_says(time, more):
    rng, robot = np.random.default_rng(3), tendon_robot()
    prior, state = robot.prior, moving(rng, robot.prior, GRID)
    located = locate(GRID, [readings(time, 1e-3 * rng.standard_normal((2, 3)), **more)])
    ((*_, batch),) = measurement_factors(prior, located, state, state)
    assert batch.nodes.shape[1] == NODES.size * (1 if time[0] == 0.5 else 2)

    def moved(step):
        there = state.retract(step.reshape(*GRID.shape, state.dof))
        ((*_, again),) = measurement_factors(prior, located, there, state)
        return again.terms.residual.ravel()

    jacobian = np.zeros((2, 3, 3 * NODES.size, state.dof))
    for row, nodes in enumerate(batch.nodes):
        jacobian[row][:, nodes, batch.dofs] = batch.jacobian[row]
    slope_test(lambda step: moved(0.1 * step), 0.1 * jacobian.reshape(6, -1))  # soft robot


ROD = SeparablePrior(
    np.repeat([1e-9, 1.0, 1e-2], [3, 2, 1]), 1.0,
    BaseVariance(np.full(6, 1e-10), np.repeat([1e-9, 0.5, 1e-4], [3, 2, 1])),
)  # fmt: skip
LONG = 0.7


def drawn_rod(rng, nodes, fine=16):
    """Arclengths, poses and strains of a rod drawn exactly, in `fine` pieces an interval."""
    s = np.linspace(0.0, LONG, (nodes - 1) * fine + 1)
    steps = np.sqrt(ROD.psd_strain_arclength * s[1]) * rng.standard_normal((s.size - 1, 6))
    begin = np.sqrt(ROD.base.strain) * rng.standard_normal(6)
    strain = ROD.rest_strain + begin + np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])
    pose = [ROD.base_pose @ se3.exp(np.sqrt(ROD.base.pose) * rng.standard_normal(6))]
    for twist in s[1] * 0.5 * (strain[1:] + strain[:-1]):
        pose.append(pose[-1] @ se3.exp(twist))
    return s, np.array(pose), strain


def shortening(s, strain, channel):
    """What a channel is shorter by than in the straight robot, m."""
    speed = (np.linalg.norm(channel.tangent(s, e), axis=-1) for e in (ROD.rest_strain, strain))
    return np.subtract(*(np.trapezoid(each, s) for each in speed))


@pytest.mark.parametrize("pitch", [0.3, 0.07, 0.05])
def test_a_winding_tendon_is_as_long_as_it_winds_between_nodes(pitch):
    bend, s = np.array([0.0, 0.0, 1.0, 0.0, 10.0, 0.0]), np.linspace(0.0, LENGTH, 20_001)
    true = shortening(s, np.tile(bend, (s.size, 1)), Channel(0.004, 0.0, pitch))
    shape = se3.exp(NODES[:, None] * bend)[None], np.tile(bend, (1, 5, 1)), *np.zeros((2, 1, 5, 6))
    one = {"radius": [0.004], "angle": [0.0], "end": [LENGTH], "pitch": [pitch]}
    pulled, grid = readings([0.0], [[true]], **one), Grid(NODES, [0.0])
    ((*_, batch),) = measurement_factors(ROD, locate(grid, [pulled]), State(*shape), State(*shape))
    assert abs(batch.terms.residual.item()) < 1e-5  # 1.5e-4, 9e-4 and 7e-3 at the nodes alone


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [0.0, 0.5])
@pytest.mark.parametrize("nodes", [5, 16])
def test_what_bends_between_nodes_is_in_the_covariance_of_what_tendons_read(nodes, pitch):
    rng, count, std = np.random.default_rng(nodes), 60, 5e-5
    channel, grid = Channel(0.005, 0.0, pitch or np.inf), Grid(np.linspace(0.0, LONG, nodes), [0.0])
    weights, squares = up_to(grid.arclength, LONG), []
    at = {"time": np.zeros(1), "arclength": np.full(1, LONG)}
    one = {"radius": np.full(1, 0.005), "angle": np.zeros(1), "end": np.full(1, LONG)}
    for _ in range(count):
        s, pose, strain = drawn_rod(rng, nodes)
        seen = pose[-1] @ se3.exp(np.repeat([1e-3, 0.1], 3) * rng.standard_normal(6))
        pull = shortening(s, strain, channel) + std * rng.standard_normal()
        tip = PoseReadings(**at, values=seen[None], cov=np.repeat([1e-6, 1e-2], 3))
        tendon = TendonReadings(
            **at, values=np.full((1, 1), pull), cov=std**2, pitch=np.full(1, pitch), **one
        )
        found = estimate(ROD, grid, [tip, tendon], gate=None)
        bends = np.arange(nodes) * found.state.dof + 6 + 4  # about y
        cov = found.marginals.cov[0][np.ix_(bends, bends)]
        error = found.state.strain[0, :, 4] - strain[:: s.size // (nodes - 1), 4]
        squares.append((weights @ error) ** 2 / (weights @ cov @ weights))
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], count) / count
    assert low < np.mean(squares) < high  # 19 with a straight one and strains at 5 nodes alone


def simulated_state(tension, nodes):
    robot = tendon_robot()
    rod, tendons = simulated(robot)
    at = solve_shape(rod, tendons, Loads(tension)).at(nodes)
    return State(at.pose[None], at.strain[None], np.zeros((1, nodes.size, 6)))


def test_the_simulators_shape_has_the_displacements_of_its_statics():
    robot, tension = tendon_robot(), np.array([1.0, 0.2, 0.4, 0.8, 0.1, 0.6])
    t, nodes = robot.tendons, np.sort(np.r_[np.linspace(0.0, LENGTH, 41), ENDS[0] - 1e-9])
    pulled = t.settings() | {"compliance": 1.0 / t.stiffness}
    at = simulated_state(tension, nodes)
    values = np.r_[np.zeros(6), tension][None]
    given = {"time": np.zeros(1), "arclength": np.full(1, LENGTH), "cov": 1e-10}
    expected = TendonReadings(values=values, **given, **pulled).residual_over(nodes, at)
    places, first = t.path(np.zeros(1))[0][:, 0], at.strain[0, 0]
    stretched = [e[2] - 1.0 + np.cross(e[3:], places)[:, 2] for e in (first, at.strain[0, -1])]
    beyond = np.where(t.end == ENDS[0], 0.0, ENDS[1] - ENDS[0])
    longer = ENDS[0] * stretched[0] + beyond * stretched[1]
    np.testing.assert_allclose(expected[0], tension / t.stiffness - longer, atol=1e-8)


def test_a_tendon_that_may_go_slack_says_nothing_once_its_channel_is_shorter():
    at = simulated_state(np.array([1.0, 0, 0, 0, 0, 0]), NODES)
    both = readings([0.0], [[-1e-3, 5e-3, 0.0]]).residual_over(NODES, at)[0]
    one = readings([0.0], [[-1e-3, 5e-3, 0.0]], one_sided=np.ones(3))
    assert both[0] > 0.0 > both[1]
    np.testing.assert_allclose(one.residual_over(NODES, at)[0, :2], [0.0, both[1]])
    assert not one.jacobian_over(NODES, at)[0, 0].any()


def test_tendons_make_the_shape_sure_where_they_run():
    robot = tendon_robot()
    pulled = readings([0.0, 0.5, 1.0], np.zeros((3, 3)))
    unread = estimate(robot.prior, GRID, []).at(LENGTH, 0.5)
    found = estimate(robot.prior, GRID, [pulled])
    assert found.solve.converged
    assert found.at(LENGTH, 0.5).std_position < 0.5 * unread.std_position


@pytest.mark.parametrize("pitch", [0.0, 0.3, 0.12, 0.06])
@pytest.mark.parametrize("count", [1, 2, 4, 8])
def test_tendons_read_between_time_nodes_err_together(count, pitch):
    """Many read at one moment tell no more of its nodes than a node there lets them."""
    angle = np.linspace(0.0, np.pi, count)
    channels = {"radius": np.full(count, 0.0045), "angle": angle, "end": np.full(count, 0.2)}
    channels["pitch"] = np.full(count, pitch)
    pulled = readings([0.25], np.zeros((1, count)), **channels)
    coarse, fine = (
        estimate(tendon_robot().prior, Grid(NODES, time), [pulled])
        for time in ([0.0, 0.5, 1.0], [0.0, 0.25, 0.5, 1.0])
    )
    for time in (0.0, 0.5):
        stds = [np.sqrt(p.at(LENGTH, time).cov[3, 3]) for p in (coarse, fine)]
        assert 0.99 * stds[1] < stds[0] < 1.1 * stds[1]


def test_displacements_that_contradict_others_are_no_traceback():
    values = np.zeros((5, 3))
    values[2, 0] = 1e-3
    with pytest.warns(FalseConfidenceWarning, match=r"100 % of pull.*see scan_contacts"):
        found = estimate(tendon_robot().prior, GRID, [readings(np.full(5, 0.5), values)])
    assert found.solve.refused == {}


def test_a_recording_keeps_tendons_with_their_channels(tmp_path):
    rng = np.random.default_rng(5)
    given = readings([0.0, 0.5], rng.standard_normal((2, 6)), compliance=np.full(3, 1e-4))
    with Journal(tmp_path / "log") as journal:
        journal.write(given)
    recording = load_recording(tmp_path / "log")
    (found,), _ = recording.readings(["pull"], tendon_robot(), (0.0, 1.0))
    np.testing.assert_allclose(found.values, given.values)
    for name in (*CHANNELS, "compliance", "pitch"):
        np.testing.assert_allclose(getattr(found, name), getattr(given, name))


def test_what_cannot_be_read_is_one_sentence():
    robot = tendon_robot()
    beyond = readings([0.0], np.zeros((1, 3)), end=np.array([0.2, 0.3, 0.1]))
    bias = SensorParameter("b", "bias", ("pull",), np.zeros(3), np.ones(3))
    for problem, sentence in [
        (lambda: estimate(robot.prior, GRID, [beyond]), "tendon 1 ends at 0.3 m, beyond"),
        (lambda: readings([0.0], np.zeros((1, 2))), "give .*3"),
        (lambda: readings([0.0], np.zeros((1, 3)), slack=np.zeros(2)), "slack has 2 numbers for 3"),
        (
            lambda: estimate(
                robot.prior, GRID, [readings([0.0], np.zeros((1, 3)))], sensor_parameters=[bias]
            ),
            "not estimated; leave them out",
        ),
        (
            lambda: estimate_static(robot.prior, NODES, [readings([0.0], np.zeros((1, 3)))]),
            "no readings of the whole robot",
        ),
    ]:
        with pytest.raises(SensorError, match=sentence):
            problem()
