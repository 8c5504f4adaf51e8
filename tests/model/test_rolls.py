"""Rolls about the body's z: a symmetry that steps follow, and no factor takes for knowledge."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, motion, prior, sixes, states
from glissando.estimation.transported import transport, transported
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.priors.separable import SeparablePrior
from glissando.model.state import DOF, AcceleratedState
from glissando.solver.block_tridiagonal import Marginals
from oracles import dense
from separable_rod import GRID as RATED_GRID
from separable_rod import rated, separable
from slope import slope_test

M = 6
GRID = Grid([0.0, 0.2, 0.4], [0.0, 0.1, 0.25])


def drawn(rng, kind):
    """States (M,) with the fields of a kind of prior."""
    plain = states(rng, M)
    if kind == "plain":
        return plain
    rated = replace(plain, strain_rate=sixes(rng, M))
    return rated if kind == "rated" else replace(rated, inertia=sixes(rng, M))


KINDS = ["plain", "rated", "with inertia"]


@law
@given(generators, st.sampled_from(KINDS), st.floats(0.0, 3.0))
def test_a_difference_is_the_step_that_leads_there(rng, kind, angle):
    here = drawn(rng, kind)
    step = rng.standard_normal((M, here.dof))
    step[:, 3:5] *= 0.5
    step[:, 5] = angle * rng.choice([-1.0, 1.0], M)
    there = here.retract(step)
    np.testing.assert_allclose(there.difference(here), step, rtol=0.0, atol=1e-11)
    again = here.retract(there.difference(here))
    for one, other in zip(again.fields(), there.fields(), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-11)


@law
@given(generators, st.sampled_from(KINDS))
def test_a_small_step_adds_to_fields_and_moves_poses_on_the_right(rng, kind):
    here = drawn(rng, kind)
    step = 1e-5 * rng.standard_normal((M, here.dof))
    there = here.retract(step)
    np.testing.assert_allclose(there.pose, here.pose @ se3.exp(step[:, :6]), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(there.rise_from(here), step, rtol=0.0, atol=1e-8)


@law
@given(generators, st.floats(-3.0, 3.0))
def test_a_roll_leaves_the_curve_and_its_motion_in_the_world(rng, angle):
    here = replace(states(rng, M), strain_rate=sixes(rng, M), inertia=sixes(rng, M))
    step = np.zeros((M, here.dof))
    step[:, 5] = angle
    step[:, 6:24] = angle * np.hstack([rolling(field) for field in here.fields()[1:4]])
    there = here.retract(step)
    np.testing.assert_allclose(there.pose[:, :3, 2:], here.pose[:, :3, 2:], atol=1e-13)
    for one, other in zip(here.fields()[1:4], there.fields()[1:4], strict=True):
        before, after = in_world(here.pose, one), in_world(there.pose, other)
        np.testing.assert_allclose(after, before, atol=1e-13)
    np.testing.assert_array_equal(there.inertia, here.inertia)


def rolling(field):
    """How fields (…, 6) of the body frame change per angle that the body rolls by."""
    return np.cross(field.reshape(*field.shape[:-1], 2, 3), [0.0, 0.0, 1.0]).reshape(field.shape)


def in_world(pose, field):
    """Both halves (M, 2, 3) of fields of the body frame in the world's."""
    return np.einsum("mij,mhj->mhi", pose[:, :3, :3], field.reshape(-1, 2, 3))


def test_an_acceleration_is_carried_like_the_other_fields_of_the_body():
    rng = np.random.default_rng(0)
    plain, acceleration, step = states(rng, M), sixes(rng, M), rng.standard_normal((M, 24))
    moved = AcceleratedState(*plain.fields(), acceleration=acceleration).retract(step)
    rated = replace(plain, strain_rate=acceleration).retract(step)
    np.testing.assert_array_equal(moved.acceleration, rated.strain_rate)
    for one, other in zip(moved.fields(), rated.fields(), strict=False):
        np.testing.assert_array_equal(one, other)


def alike(values):
    """Densities that are the same across z."""
    values = np.array(values)
    values[..., ::3] = values[..., 1::3]
    return values


def white(state):
    names = "psd_velocity_time", "psd_strain_arclength", "psd_strain_time", "psd_velocity_arclength"
    plain = prior(base=False, base_pose=state.pose[0, 0])
    return replace(plain, **{name: alike(getattr(plain, name)) for name in names})


def priors():
    """Priors alike across z, states of their grids and the numbers of a node."""
    rng = np.random.default_rng(3)
    state, still = (motion(rng, grid, wander=2e-4) for grid in (GRID, RATED_GRID))
    moving = rated(rng, still)
    shape = separable(base_pose=moving.pose[0, 0])
    shape = replace(shape, psd_strain_arclength=alike(shape.psd_strain_arclength))
    return [
        pytest.param(white(state), GRID, state, id="white noise"),
        pytest.param(shape, RATED_GRID, moving, id="separable"),
    ]


def between_nodes(prior_, grid, state, about=None):
    """Factors of a prior but those of the base."""
    found = list(prior_.factors(grid, state, about or state, slice(0, grid.time.size)))
    return found[2:] if isinstance(prior_, SeparablePrior) else found


def static(prior_, grid, state, about=None):
    """The same of shapes that hold still."""
    return [b for b in prior_.static_factors(grid, state) if b.nodes.shape[1] > 1]


@pytest.mark.parametrize("away", [0.0, 0.3])
@pytest.mark.parametrize(("prior_", "grid", "state"), priors())
def test_errors_of_the_axes_of_where_weights_come_from_have_their_slopes(prior_, grid, state, away):
    rng = np.random.default_rng(5)
    shape = (*grid.shape, state.dof)
    about = state.retract(away * rng.standard_normal(shape) * (np.arange(state.dof) > 4))
    for i, batch in enumerate(between_nodes(prior_, grid, state, about)):

        def moved(step, i=i):
            there = state.retract(step.reshape(shape))
            return between_nodes(prior_, grid, there, about)[i].terms.residual.ravel()

        jacobian = np.zeros((*batch.terms.residual.shape, state.strain[..., 0].size, state.dof))
        for m, nodes in enumerate(batch.nodes):
            for j, node in enumerate(nodes):
                jacobian[m, :, node, batch.dofs] += batch.jacobian[m, :, j]
        slope_test(moved, jacobian.reshape(batch.terms.residual.size, -1))


@pytest.mark.parametrize("factors", [between_nodes, static])
@pytest.mark.parametrize(("prior_", "grid", "state"), priors())
def test_a_roll_of_the_whole_robot_is_no_error_and_nothing_is_known_of_it(
    prior_, grid, state, factors
):
    roll = np.zeros((*grid.shape, state.dof))
    roll[..., 5] = 1.0
    roll[..., 6:] = np.concatenate([rolling(field) for field in state.fields()[1:]], axis=-1)
    there = state.retract(2.0 * roll)
    for here, rolled in zip(
        factors(prior_, grid, state), factors(prior_, grid, there, there), strict=True
    ):
        before, after = (b.terms.whiten(b.terms.residual) for b in (here, rolled))
        lengths = np.linalg.norm(before, axis=1)
        np.testing.assert_allclose(np.linalg.norm(after, axis=1), lengths, rtol=1e-8)
        whole = roll.reshape(-1, state.dof)[here.nodes][..., here.dofs]
        slope = np.einsum("mrcd,mcd->mr", here.jacobian, whole)
        size = np.abs(here.jacobian).max() * np.abs(roll).max()
        np.testing.assert_allclose(slope, 0.0, atol=1e-12 * size)


def test_errors_of_a_prior_that_tells_directions_apart_are_left_as_they_are():
    """A ribbon bends one way more easily: a roll of it is an error, and known."""
    rng = np.random.default_rng(4)
    state = motion(rng, GRID)
    ribbon = prior(base=False, base_pose=state.pose[0, 0])
    for i, batch in enumerate(between_nodes(ribbon, GRID, state)):

        def moved(step, i=i):
            there = state.retract(step.reshape(*GRID.shape, DOF))
            return between_nodes(ribbon, GRID, there, state)[i].terms.residual.ravel()

        jacobian = dense.spread(batch, state.strain[..., 0].size)
        slope_test(moved, jacobian.reshape(-1, jacobian.shape[-1]))


@law
@given(generators, st.sampled_from(KINDS))
def test_a_step_goes_on_from_where_one_that_rolled_led_as_differences_say(rng, kind):
    start = drawn(rng, kind)
    step = 0.3 * rng.standard_normal((M, start.dof))
    step[:, :5], step[:, 5] = 0.0, rng.uniform(-3.0, 3.0, M)
    end, small = start.retract(step), 1e-6 * np.eye(start.dof)
    for n in range(M):
        here, there = start.take(np.full(start.dof, n)), end.take(np.full(start.dof, n))
        ahead, behind = (here.retract(step[n] + way * small) for way in (1.0, -1.0))
        slopes = (ahead.difference(there) - behind.difference(there)).T / 2e-6
        np.testing.assert_allclose(start.slope_to(end)[n], slopes, atol=1e-7)
    both = start.slope_to(end) @ end.slope_to(start)
    np.testing.assert_allclose(both, np.broadcast_to(np.eye(start.dof), both.shape), atol=1e-12)


@law
@given(generators, st.sampled_from(KINDS), st.integers(0, 2))
def test_covariances_go_on_with_the_axes_as_the_dense_products_do(rng, kind, others):
    start = drawn(rng, kind).reshape(3, 2)
    step = 0.3 * rng.standard_normal((3, 2, start.dof))
    end = start.retract(step)
    size = 2 * start.dof + others  # with numbers of sensor parameters, which stay
    cov, cross = rng.standard_normal((3, size, size)), rng.standard_normal((2, size, size))
    turns = np.broadcast_to(np.eye(size), (3, size, size)).copy()
    for n in range(2):
        at = slice(n * start.dof, (n + 1) * start.dof)
        turns[:, at, at] = start.slope_to(end)[:, n]
    back = turns.swapaxes(1, 2)
    found = transported(start, end, Marginals(cov.copy(), cross.copy()))
    np.testing.assert_allclose(found.cov, turns @ cov @ back, atol=1e-12)
    np.testing.assert_allclose(found.cross, turns[:-1] @ cross @ back[1:], atol=1e-12)
    first = np.ascontiguousarray(start.slope_to(end)[:, 0, None, :DOF, :DOF])
    own = transport(first, cov[:, :DOF, :DOF].copy())  # what a sensor sees of a node, by itself
    np.testing.assert_allclose(own, found.cov[:, :DOF, :DOF], atol=1e-12)
