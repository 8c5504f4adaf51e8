"""The state between the nodes, and the law that an unmeasured node changes nothing.

On a chain (one time, or one arclength) the law holds exactly while the rate is constant, however
far the body turns. Where the rate varies, by an amount `bend`, the exact transitions are those of
the interval's mean rate: means then differ in the second order of `bend`, covariances in the first.
"""

import numpy as np
import pytest
from hypothesis import given

from draws import generators, law, motion, prior
from glissando.errors import OutsideGridError
from glissando.estimation.batch import estimate
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.priors.steps import ARCLENGTH, TIME
from glissando.model.sensors.sensors import (
    GyroReadings,
    PoseReadings,
    PositionReadings,
    StrainReadings,
)
from glissando.model.state import DOF, State
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.normal_equations import system_shape
from mechanical_rod import GRID as ROD_GRID
from mechanical_rod import mechanical, moving
from oracles import dense
from oracles.steps import between
from oracles.transitions import full_bridge as bridge_into
from separable_rod import GRID as RATED_GRID
from separable_rod import rated, separable

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
EXACT = SolverOptions(tolerance=1e-7, max_iterations=100)
STRAIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
TWIST = np.array([0.03, -0.02, 0.02, 0.7, -0.5, 0.6])
SHEAR = np.array([0.01, 0.02, -0.01, 0.5, 0.8, -0.4])


def interpolated(s, t, state, grid=GRID):
    (points,) = sort_points(grid, np.atleast_1d(s), np.atleast_1d(t))
    return prior().interpolate(grid, state, state, points)


def along_arclength(bend, nodes, *, strain=STRAIGHT):
    """Estimate of one instant: poses of both ends, the tip's turned away from rest by `bend`."""
    length = nodes[-1]
    tip = se3.exp(length * strain) @ se3.exp(bend * TWIST)
    ends = {"time": np.zeros(2), "arclength": np.array([0.0, length])}
    spin = bend * np.array([[0.3, 0.2, 0.1], [1.0, -1.0, 0.5]])
    readings = [
        PoseReadings(**ends, values=np.stack([np.eye(4), tip]), cov=1e-6),
        GyroReadings(**ends, values=spin, cov=1e-4),
    ]
    return estimate(prior(rest_strain=strain), Grid(nodes, [0.0]), readings, options=EXACT)


def along_time(bend, nodes, *, velocity=np.zeros(6)):  # noqa: B008 - never written to
    """Estimate of one cross-section: poses at both ends of its time, the last turned by `bend`."""
    last = nodes[-1]
    end = se3.exp(last * velocity) @ se3.exp(bend * TWIST)
    ends = {"time": np.array([0.0, last]), "arclength": np.zeros(2)}
    strain = STRAIGHT + bend * np.stack([SHEAR, -2.0 * SHEAR])
    spin = np.stack([velocity[3:], velocity[3:] + bend * TWIST[3:]])
    readings = [
        PoseReadings(**ends, values=np.stack([np.eye(4), end]), cov=1e-6),
        StrainReadings(**ends, values=strain, cov=1e-4),
        GyroReadings(**ends, values=spin, cov=1e-4),
    ]
    return estimate(prior(base=False), Grid([0.0], nodes), readings, options=EXACT)


def apart(one, other):
    """Difference of means and of covariances at a point, in standard deviations there."""
    std = np.sqrt(np.diagonal(other.cov))
    states = (State(e.pose, e.strain, e.velocity) for e in (one, other))
    mean = next(states).difference(next(states)) / std
    return np.abs(mean).max(), np.abs((one.cov - other.cov) / np.outer(std, std)).max()


def change_by_inserting(chain, bend, nodes, extra, **more):
    """What an unmeasured node at `extra` changes in mean and covariance there."""
    coarse = chain(bend, nodes, **more)
    fine = chain(bend, np.sort(np.append(nodes, extra)), **more)
    place = (extra, 0.0) if chain is along_arclength else (0.0, extra)
    return apart(coarse.at(*place), fine.at(*place))


ENDS = np.array([0.0, 0.4])
CHAINS = pytest.mark.parametrize("chain", [along_arclength, along_time], ids=lambda c: c.__name__)


@CHAINS
@pytest.mark.parametrize("nodes", [ENDS, np.array([0.0, 0.2, 0.4])], ids=len)
def test_an_unmeasured_node_changes_nothing_where_strain_is_small(chain, nodes):
    mean, cov = change_by_inserting(chain, 1e-7, nodes, 0.15)
    assert mean < 1e-6
    assert cov < 1e-6


@pytest.mark.parametrize("turn", [0.5, 1.0, 2.0])
def test_an_unmeasured_node_changes_nothing_on_a_circular_arc(turn):
    strain = STRAIGHT + np.r_[0.02, 0.01, 0.03, turn / 0.4 * np.array([0.6, 0.0, 0.8])]
    mean, cov = change_by_inserting(along_arclength, 0.0, ENDS, 0.15, strain=strain)
    assert mean < 1e-6
    assert cov < 1e-6


@pytest.mark.parametrize("turn", [0.5, 1.0, 2.0])
def test_an_unmeasured_node_changes_nothing_in_a_steady_screw(turn):
    velocity = np.r_[0.3, -0.2, 0.5, turn / 0.4 * np.array([0.0, 0.6, 0.8])]
    mean, cov = change_by_inserting(along_time, 0.0, ENDS, 0.15, velocity=velocity)
    assert mean < 1e-6
    assert cov < 1e-6


@CHAINS
def test_what_an_unmeasured_node_changes_falls_with_the_bend(chain):
    bends = 0.2 * 0.5 ** np.arange(5)
    means, covs = np.transpose([change_by_inserting(chain, b, ENDS, 0.15) for b in bends])
    orders = [np.polyfit(np.log(bends), np.log(v), 1)[0] for v in (means, covs)]
    print(f"{chain.__name__}: order {orders[0]:.2f} of the mean, {orders[1]:.2f} of the covariance")
    print(
        "  ".join(f"{b:.3g}: {m:.1e} {c:.1e}" for b, m, c in zip(bends, means, covs, strict=True))
    )
    assert orders[0] > 1.9
    assert orders[1] > 0.95


@CHAINS
def test_what_an_unmeasured_node_changes_falls_as_the_grid_is_refined(chain):
    counts = np.array([2, 4, 8, 16])
    changes = [change_by_inserting(chain, 0.5, np.linspace(0, 0.4, n + 1), 0.157) for n in counts]
    means, covs = np.transpose(changes)
    orders = [-np.polyfit(np.log(counts), np.log(v), 1)[0] for v in (means, covs)]
    print(f"{chain.__name__}: order {orders[0]:.2f} of the mean, {orders[1]:.2f} of the covariance")
    assert min(orders) > 1.5


@CHAINS
def test_a_reading_between_nodes_says_what_it_would_say_at_a_node(chain):
    """Equation (13): widened by its bridge, it leaves the same posterior at both ends."""
    is_arc = chain is along_arclength
    place = np.array([0.0, 0.15, 0.4])
    s, t = (place, 0.0 * place) if is_arc else (0.0 * place, place)
    pose = se3.exp(s[:, None] * STRAIGHT)
    ends = {"time": t[::2], "arclength": s[::2]}
    readings = [
        PositionReadings(time=t, arclength=s, values=pose[:, :3, 3], cov=1e-5),
        PoseReadings(**ends, values=pose[::2], cov=1.0),
        StrainReadings(**ends, values=np.tile(STRAIGHT, (2, 1)), cov=1e-4),
    ]
    found = []
    for nodes in (ENDS, place):
        grid = Grid(nodes, [0.0]) if is_arc else Grid([0.0], nodes)
        posterior = estimate(prior(base=is_arc), grid, readings, options=EXACT)
        found.append([posterior.at(s[i], t[i]) for i in (0, 2)])
    for coarse, fine in zip(*found, strict=True):
        mean, cov = apart(coarse, fine)
        assert mean < 1e-9
        assert cov < 1e-9


@law
@given(generators)
def test_interpolation_reproduces_the_nodes(rng):
    state = motion(rng, GRID)
    s, t = (a.ravel() for a in np.meshgrid(GRID.arclength, GRID.time))
    found = interpolated(s, t, state)
    flat = state.flatten()
    np.testing.assert_array_equal(found.state.pose, flat.pose)
    np.testing.assert_array_equal(found.state.strain, flat.strain)
    np.testing.assert_array_equal(found.state.velocity, flat.velocity)
    np.testing.assert_array_equal(found.nodes[:, 0], np.arange(s.size))
    np.testing.assert_array_equal(found.jacobian[:, :, 0], np.tile(np.eye(DOF), (s.size, 1, 1)))
    np.testing.assert_array_equal(found.cov, 0.0)


@law
@given(generators)
def test_interpolation_runs_into_the_nodes_from_every_side(rng):
    state, near = motion(rng, GRID), 1e-7
    at_node = state.take((1, 1))
    for s in (0.1 - near, 0.1, 0.1 + near):
        for t in (0.1 - near, 0.1, 0.1 + near):
            found = interpolated(s, t, state)
            assert np.abs(found.state.take(0).difference(at_node)).max() < 1e-3
            everything = found.jacobian[0].sum(axis=1) - np.eye(DOF)
            assert np.abs(everything).max() < 2e-3
            assert np.abs(found.cov).max() < 1e-3


@law
@given(generators)
def test_a_point_in_a_cell_is_two_steps_along_arclength_and_one_along_time(rng):
    """Between nodes 2 and 3 of arclength, 1 and 2 of time: s = 0.25 + 0.05, t = 0.1 + 0.06."""
    state, soft = motion(rng, GRID), prior()
    length, offset, wait, elapsed = np.array([[0.15], [0.05], [0.15], [0.06]])
    steps = []
    for k in (1, 2):
        ends = state.take(([k], [2])), state.take(([k], [3]))
        middle = 0.5 * (ends[0].strain + ends[1].strain)
        weight = GRID.time_spans[k]
        densities = soft.psd_strain_arclength / weight, soft.psd_velocity_arclength / weight
        bridge = bridge_into(middle, length, offset, *densities, rigid=True)
        steps.append(between(ARCLENGTH, *ends, length, offset, bridge))
    (early, *of_early, cov_early), (late, *of_late, cov_late) = steps
    span = np.interp([0.3], GRID.arclength, GRID.arclength_spans)
    mean = 0.5 * (state.velocity[1] + state.velocity[2])
    rate = (2.0 * mean[2:3] + mean[3:4]) / 3.0
    densities = soft.psd_velocity_time / span, soft.psd_strain_time / span
    bridge = bridge_into(rate, wait, elapsed, *densities, rigid=False)
    expected, j0, j1, cov = between(TIME, early, late, wait, elapsed, bridge)
    cov = cov + j0 @ cov_early @ j0.swapaxes(1, 2) + j1 @ cov_late @ j1.swapaxes(1, 2)
    jacobian = np.stack([j0 @ j for j in of_early] + [j1 @ j for j in of_late], axis=2)

    found = interpolated(0.3, 0.16, state)
    np.testing.assert_array_equal(found.nodes, [[6, 7, 10, 11]])
    assert np.abs(found.state.difference(expected)).max() < 1e-12
    np.testing.assert_allclose(found.jacobian, jacobian, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found.cov, cov, rtol=0.0, atol=1e-12 * np.abs(cov).max())


def test_covariance_anywhere_is_that_of_the_dense_inverse():
    rng = np.random.default_rng(50)
    s, t = rng.uniform(0.0, 0.4, 12), rng.uniform(0.0, 0.25, 12)
    s[:6:2], t[1:9:3] = GRID.arclength[1], GRID.time[1]  # on nodes and lines as well
    posterior = estimate(prior(), GRID, [])
    soft, located, state = prior(), locate(GRID, []), posterior.state
    shape = system_shape(GRID.time.size, 18 * GRID.arclength.size)
    equations = linearize(soft, located, state, state, np.empty(shape))
    assert np.abs(equations.rhs).max() < 1e-9
    whole = dense.assemble(soft.factors(GRID, state, state, slice(0, 3)), 12).cov
    for points in sort_points(GRID, s, t):
        found = soft.interpolate(GRID, state, state, points)
        for row, nodes in enumerate(found.nodes):
            spread = np.zeros((DOF, 12, DOF))
            spread[:, nodes] = found.jacobian[row]
            spread = spread.reshape(DOF, -1)
            expected = spread @ whole @ spread.T + found.cov[row]
            at = posterior.at(points.arclength[row], points.time[row])
            np.testing.assert_allclose(at.cov, expected, atol=1e-9 * np.abs(expected).max())


def test_confidence_is_least_between_the_nodes():
    posterior = along_arclength(0.0, ENDS)
    std = posterior.at(np.linspace(0.0, 0.4, 9), 0.0).std_position
    assert np.argmax(std) in (3, 4, 5)


def test_queries_off_the_grid_are_refused_by_row():
    posterior = along_arclength(0.0, ENDS)
    with pytest.raises(
        OutsideGridError, match=r"2 of 4 rows .* rows 1, 3 have arclength 0.5, -0.1"
    ):
        posterior.at([0.0, 0.5, 0.4, -0.1], 0.0)
    with pytest.raises(OutsideGridError, match=r"row 0 has time 3 s, up to 3 s outside \[0, 0\]"):
        posterior.at(0.2, 3.0)
    with pytest.raises(OutsideGridError, match=r"Query: 3 of 3 rows"):
        posterior.at([0.1, 0.2, np.nan], [1.0, 2.0, 0.0])


def test_points_within_rounding_of_an_end_are_on_the_grid():
    posterior = along_arclength(0.0, ENDS)
    found = posterior.at([-1e-12, 0.4 + 1e-12], 0.0)
    np.testing.assert_array_equal(found.pose, posterior.state.pose[0])


def of_every_prior():
    """A prior of each kind, its grid and a state of it that bends and moves."""
    rng = np.random.default_rng(31)
    rod = mechanical()
    rated_state = rated(rng, motion(rng, RATED_GRID, wander=0.05))
    return [
        pytest.param(prior(), GRID, motion(rng, GRID, wander=0.05), id="white noise"),
        pytest.param(separable(), RATED_GRID, rated_state, id="separable"),
        pytest.param(rod, ROD_GRID, moving(rng, rod), id="mechanical"),
    ]


@pytest.mark.parametrize(("any_prior", "grid", "state"), of_every_prior())
def test_the_state_is_continuous_in_time_between_arclength_nodes_as_on_them(any_prior, grid, state):
    """What an interval of arclength leaves is that of the time node which is near."""
    near, node = 1e-8, float(grid.time[1])
    places = np.concatenate([grid.arclength, 0.3 * grid.arclength[:-1] + 0.7 * grid.arclength[1:]])
    for place in places:
        before, here, after, inside = (
            any_prior.interpolate(grid, state, state, *sort_points(grid, np.array([place]), when))
            for when in np.array([[node - near], [node], [node + near], [node + 0.03]])
        )
        wide = np.sqrt(np.diagonal(inside.cov[0]))
        for there in (before, after):
            for field in ("pose", "strain", "velocity"):
                values = (getattr(each.state, field) for each in (there, here))
                np.testing.assert_allclose(*values, atol=1e-4)
            std, std_here = (
                np.sqrt(np.maximum(np.diagonal(each.cov[0]), 0.0)) for each in (there, here)
            )
            np.testing.assert_array_less(np.abs(std - std_here), 2e-3 * wide)
