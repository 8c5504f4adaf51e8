"""What the prior weighs, against Van Loan's covariances and the span each node stands for."""

from dataclasses import replace

import numpy as np
import pytest

from draws import motion, prior, sixes
from glissando import (
    BaseVariance,
    GlissandoError,
    SeparablePrior,
    WhiteNoisePrior,
    estimate,
    estimate_static,
)
from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from oracles import dense

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25])
ABOUT = motion(np.random.default_rng(80), GRID)
STATE = motion(np.random.default_rng(81), GRID)
PAIR_S, CARRIED_S, PAIR_T, CARRIED_T, BASE = range(5)


def batches(soft=None, grid=GRID, state=STATE, about=ABOUT):
    soft = prior() if soft is None else soft
    return list(soft.factors(grid, state, about, slice(0, grid.time.size)))


def expected_covariances(which):
    """Covariance of every factor of a batch, one at a time, with the nodes it joins."""
    soft, (k_count, n_count) = prior(), GRID.shape
    if which in (PAIR_S, CARRIED_S):
        for k in range(k_count):
            for n in range(n_count - 1):
                rate = 0.5 * (ABOUT.strain[k, n] + ABOUT.strain[k, n + 1])
                h, span = np.diff(GRID.arclength)[n], GRID.time_spans[k]
                cov = dense.pair_covariance(rate, h, soft.psd_strain_arclength)
                if which == CARRIED_S:
                    psd = soft.psd_velocity_arclength
                    cov = dense.carried_covariance(rate, h, psd, rigid=True)
                yield (k * n_count + n, k * n_count + n + 1), cov / span
    else:
        for k in range(k_count - 1):
            for n in range(n_count):
                rate = 0.5 * (ABOUT.velocity[k, n] + ABOUT.velocity[k + 1, n])
                h, span = np.diff(GRID.time)[k], GRID.arclength_spans[n]
                cov = dense.pair_covariance(rate, h, soft.psd_velocity_time)
                if which == CARRIED_T:
                    cov = dense.carried_covariance(rate, h, soft.psd_strain_time, rigid=False)
                yield (k * n_count + n, (k + 1) * n_count + n), cov / span


def test_a_joint_that_is_no_node_is_refused_whatever_varies_there():
    bent = SeparablePrior(
        np.r_[[1e-3] * 3, [2.0] * 3],
        1.0,
        BaseVariance(np.full(6, 1e-6), np.full(6, 1e-3)),
        rest_strain=[[0, 0, 1, 0, 3, 0], [0, 0, 1, 0, -3, 0]],
        joints=[0.25],
    )
    for call in (
        lambda: estimate(bent, Grid(np.linspace(0.0, 0.4, 5), [0.0]), []),
        lambda: estimate_static(bent, np.linspace(0.0, 0.4, 5), [], count=1),
    ):
        with pytest.raises(OutsideGridError, match=r"0\.25 m, which is not an arclength node"):
            call()


@pytest.mark.parametrize(
    ("times", "said"), [([0.8, 0.2], "rising seconds"), ([np.nan, 0.5], "finite"), ("a", "numbers")]
)
def test_paces_change_at_times_that_rise(times, said):
    stiff = np.full(6, 1e-3)
    fields = dict.fromkeys(
        ("psd_velocity_time", "psd_strain_arclength", "psd_strain_time", "psd_velocity_arclength"),
        stiff,
    )
    with pytest.raises(GlissandoError, match=said):
        WhiteNoisePrior(**fields, base=None, pace=np.ones(np.size(times) + 1), pace_times=times)
    listed = WhiteNoisePrior(**fields, base=None, pace=[1, 2.0], pace_times=[0.5])
    assert listed.pace_times.tolist() == [0.5]
    one_row = WhiteNoisePrior(**fields, base=None, rest_strain=[[0, 0, 1, 0, 0, 0]])
    assert one_row.rest_strain.shape == (6,)


@pytest.mark.parametrize("which", [PAIR_S, CARRIED_S, PAIR_T, CARRIED_T])
def test_a_step_is_weighed_by_its_process_noise_over_the_span_it_stands_for(which):
    found = batches()[which]
    expected = list(expected_covariances(which))
    np.testing.assert_array_equal(found.nodes, [nodes for nodes, _ in expected])
    log_det = 0.0
    for root, (_, cov) in zip(found.terms.sqrt_info, expected, strict=True):
        np.testing.assert_allclose(root @ cov @ root.T, np.eye(len(cov)), rtol=0.0, atol=1e-8)
        log_det += np.linalg.slogdet(cov)[1]
    assert found.terms.log_det_cov() == pytest.approx(log_det, abs=1e-6)


def test_a_pace_multiplies_densities_along_time_while_it_lasts():
    paced = replace(prior(), pace=np.array([0.01, 4.0]), pace_times=GRID.time[1:2])
    plain, found, slow = batches(), batches(paced), slice(0, GRID.shape[1])
    for which in (PAIR_T, CARRIED_T):
        ratio = found[which].terms.sqrt_info[:, 0, 0] / plain[which].terms.sqrt_info[:, 0, 0]
        np.testing.assert_allclose(ratio[slow], 10.0)
        np.testing.assert_allclose(ratio[slow.stop :], 0.5)
    for which in (PAIR_S, CARRIED_S, BASE):
        np.testing.assert_array_equal(found[which].terms.sqrt_info, plain[which].terms.sqrt_info)


def test_between_nodes_a_pace_is_that_of_its_time_step():
    """Each half of a motion with a pace is the half of a motion whose densities are so much."""
    times = np.array([0.03, 0.2])
    place = np.full(2, 0.17)
    (points,) = sort_points(GRID, place, times)
    paced = replace(prior(), pace=np.array([0.01, 4.0]), pace_times=GRID.time[1:2])
    found = paced.interpolate(GRID, STATE, ABOUT, points)
    for i, factor in enumerate(paced.pace):
        scaled = replace(
            prior(),
            psd_velocity_time=factor * prior().psd_velocity_time,
            psd_strain_time=factor * prior().psd_strain_time,
        )
        alone = scaled.interpolate(GRID, STATE, ABOUT, points)
        np.testing.assert_allclose(found.cov[i], alone.cov[i], rtol=1e-12)
        np.testing.assert_allclose(found.jacobian[i], alone.jacobian[i], rtol=1e-12)


def test_the_base_is_weighed_by_the_time_it_is_watched():
    soft, found = prior(), batches()[BASE]
    np.testing.assert_array_equal(found.nodes[:, 0], [0, 4, 8])
    density = np.concatenate([soft.base.pose, soft.base.strain, soft.base.velocity])
    for root, span in zip(found.terms.sqrt_info, GRID.time_spans, strict=True):
        np.testing.assert_allclose(root.T @ root, np.diag(span / density), rtol=1e-12)


def test_a_prior_without_a_base_has_no_base_factor():
    assert len(batches(prior(base=False))) == 4


def test_a_robot_at_rest_costs_nothing():
    rng = np.random.default_rng(82)
    rest = np.array([0.02, 0.01, 1.03, 2.0, -1.0, 0.5])
    soft = prior(rest_strain=rest, base_pose=se3.exp(sixes(rng, reach=0.3)))
    state = soft.rest_state(GRID)
    for batch in batches(soft, state=state, about=state):
        np.testing.assert_allclose(batch.terms.residual, 0.0, atol=1e-13)


def test_a_rod_that_moves_as_one_rigid_body_costs_nothing_but_its_base():
    rng = np.random.default_rng(83)
    strain, screw = np.array([0.0, 0.0, 1.0, 2.0, 1.0, -1.0]), sixes(rng, angle=2.0)
    pose = se3.exp(GRID.time[:, None] * screw)[:, None] @ se3.exp(GRID.arclength[:, None] * strain)
    ride = se3.adjoint(se3.inverse(se3.exp(GRID.arclength[:, None] * strain)))
    velocity = np.broadcast_to(ride @ screw, (3, 4, 6))
    state = type(STATE)(pose, np.broadcast_to(strain, (3, 4, 6)), velocity)
    for batch in batches(state=state, about=state)[:BASE]:
        np.testing.assert_allclose(batch.terms.residual, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("grid", "count"), [(Grid([0.0], [0.0]), 1), (Grid([0.0], [0, 1]), 3), (Grid([0, 1], [0]), 3)]
)
def test_a_lone_node_in_either_direction_needs_no_steps_there(grid, count):
    state = prior().rest_state(grid)
    assert len(batches(grid=grid, state=state, about=state)) == count
