"""The published estimator: its factors are those of the slow oracle, its coil leans on roll."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, Grid, State, load_robot
from glissando.experiments.published import PublishedPrior, published_prior, published_readings
from glissando.experiments.scenes import Scene, trial
from glissando.geometry import se3
from glissando.model.state import DOF
from oracles import published as oracle

PRIOR = published_prior(load_robot("tdcr466").prior)


def drawn(rng, grid):
    """A bent and moving robot (K, N)."""
    shape = grid.shape
    rest = PRIOR.rest_state(grid)
    return State(
        rest.pose @ se3.exp(0.02 * rng.standard_normal((*shape, 6))),
        rest.strain + rng.standard_normal((*shape, 6)) * [0.02, 0.02, 0.02, 3, 3, 1],
        0.3 * rng.standard_normal((*shape, 6)),
    )


def test_factors_are_those_of_the_slow_oracle_with_slopes_by_differences():
    rng = np.random.default_rng(0)
    grid = Grid([0.0, 0.1, 0.25, 0.466], [0.0, 0.03, 0.07])
    state = drawn(rng, grid)
    flat = state.flatten()
    along, through, base = PRIOR.factors(grid, state, state, slice(0, 3))
    for axis, batch in ((True, along), (False, through)):
        nodes = batch.nodes
        here, there = (oracle.State(*(f[nodes[:, i]] for f in flat.fields())) for i in (0, 1))
        size = grid.arclength.size
        at, steps = (nodes[:, 0] % size, np.diff(grid.arclength)) if axis else (
            nodes[:, 0] // size, np.diff(grid.time),
        )  # fmt: skip
        h = steps[at]
        twin = oracle.Axis(axis, 1.0, oracle.Settings())
        np.testing.assert_allclose(batch.terms.residual, twin.error(here, there, h), atol=1e-9)
        cov = np.linalg.inv(np.swapaxes(batch.terms.sqrt_info, 1, 2) @ batch.terms.sqrt_info)
        np.testing.assert_allclose(cov, twin.covariance(here, h), rtol=1e-6, atol=1e-12)
        slopes = oracle.derivatives(lambda a, b, t=twin, h=h: t.error(a, b, h), [here, there])
        slopes = slopes.reshape(len(h), DOF, 2, DOF)
        np.testing.assert_allclose(batch.jacobian, slopes, atol=1e-5)
    white = 1.0 / np.sqrt(oracle.Settings.factor * np.array(oracle.Settings().p0))
    np.testing.assert_allclose(base.terms.sqrt_info, np.tile(np.diag(white), (3, 1, 1)))


def test_a_constant_roll_is_set_once_and_a_later_one_leaks():
    rng = np.random.default_rng(1)
    rest = PRIOR.rest_state(Grid([0.0, 0.466], [0.0])).take(0)
    pose = np.repeat(rest.pose[-1:], 5, axis=0)
    roll = np.zeros((5, 6))
    roll[:, 5] = 1.3
    roll[4, 5] += 0.4
    tilted = pose @ se3.exp(0.1 * rng.standard_normal((5, 6)) * [0, 0, 0, 1, 1, 0])
    coil = CoilReadings(
        time=np.arange(5.0), arclength=np.full(5, 0.466), values=pose @ se3.exp(roll), cov=1e-6
    )
    found = published_readings(coil, ("roll",), rest)
    at = State(tilted, np.zeros((5, 6)), np.zeros((5, 6)))
    ours = replace(coil, values=pose)  # the same, of axes that do not roll
    apart = np.abs(found.residual(at) - ours.residual(at)).max(axis=1)
    assert apart[:4].max() < 1e-3
    assert apart[4] > 5e-3  # 23° of roll later
    nudges = 1e-6 * np.eye(DOF)
    slopes = [
        (found.residual(at.retract(d)) - found.residual(at.retract(-d))) / 2e-6
        for d in np.broadcast_to(nudges[:, None], (DOF, 5, DOF))
    ]
    np.testing.assert_allclose(found.jacobian(at), np.stack(slopes, -1), atol=1e-7)


@pytest.mark.slow
def test_parts_of_the_published_estimator_take_the_place_of_ours():
    scene = Scene("C", "oscillate", 1.0, published=("prior", "noise", "roll"), judged=0.35)
    found = trial(scene, 0)
    assert isinstance(found.posterior.prior, PublishedPrior)
    assert found.posterior.grid.time.size == 31
    assert found.readings[0].rows == 5
    assert {float(t.arclength.max()) for t in found.truth} == {0.1, 0.22, 0.34}
