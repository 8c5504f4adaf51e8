"""Unknowns of the sensors: slopes of what readings say by them, and by where they were taken."""

from dataclasses import replace

import numpy as np
import pytest

from draws import motion, prior
from glissando import PositionReadings, State, estimate
from glissando.errors import SensorError
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import states_at
from glissando.solver.normal_equations import system_shape
from scenes import LENGTH, arc, sliding_scene
from unknown_scenes import COARSE, GRID, SOFT, consistent, scattered, tracker, unknown

K, N = GRID.shape
SEPARABLE = SeparablePrior(
    np.r_[1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0],
    0.7,
    BaseVariance(np.full(6, 1e-3), np.r_[1e-3, 1e-3, 1e-3, 2.0, 2.0, 2.0]),
)


def all_kinds(rng):
    small = 0.1 * rng.standard_normal((2, 6))
    return [
        unknown("frame", "pose", "coil", "point", value=small[0]),
        unknown("mount", "coil", "point", "gyro", value=small[1], memory=0.5),
        unknown("bias", "gyro", memory=0.3, name="gyro bias"),
        unknown("bias", "point", name="point bias"),
        unknown("arclength_offset", "coil", "gyro", value=[0.003]),
        unknown("slide_lag", "coil", value=[0.01]),
        unknown("slide_play", "coil", value=[0.002]),
        unknown(
            "time_offset", "pose", value=[0.002]
        ),  # of nothing that drifts: that is second order
    ]


@pytest.mark.parametrize("kind", ["kinematic", "separable"])
def test_system_and_right_hand_side_are_those_of_the_residuals_slopes(kind):
    rng = np.random.default_rng(3)
    state, rods = motion(rng, GRID), prior()
    if kind == "separable":
        rate = rng.standard_normal(state.strain.shape)
        state, rods = State(state.pose, state.strain, state.velocity, rate), SEPARABLE
    located = locate(GRID, scattered(rng), all_kinds(rng))
    extras, wander = located.parameters.process.size, np.ones((K, 1))
    constant = located.parameters.process.memory > 1e3
    wander = np.where(constant, wander, rng.uniform(0.5, 1.5, (K, extras)))
    located = located.moved(1e-3 * wander * rng.standard_normal(extras))
    workspace = np.empty(system_shape(K, N * state.dof + extras))

    def at(step, held):
        nodes, moved = here.split(step)
        there = linearize(
            rods, located.moved(moved), state.retract(nodes), state, np.empty_like(workspace), held
        )
        pairs = zip(held, there.terms, strict=True)
        return np.concatenate([t.whiten(u.residual).ravel() for t, u in pairs])

    here = linearize(rods, located, state, state, workspace)
    of_nodes = N * state.dof
    size = of_nodes + extras
    directions = []
    for columns in located.parameters.process.columns:  # a constant moves as one
        way, mine = np.zeros((K, size)), np.zeros((K, extras))
        mine[:, columns] = rng.standard_normal((K, columns.stop - columns.start))
        way[:, of_nodes:] = np.where(constant, mine[:1], mine)
        directions.append(way)
    for _ in range(2):
        way = np.zeros((K, size))
        way[:, :of_nodes] = rng.standard_normal((K, of_nodes))
        directions.append(way)
    slopes = []
    for way in directions:
        ahead, behind = (at(h * way, here.terms) for h in (1e-6, -1e-6))
        slopes.append((ahead - behind) / 2e-6)
    slopes = np.array(slopes)

    products = []
    system = here.system
    for way in directions:
        product = np.einsum("kij,kj->ki", system.diagonal, way)
        product[1:] += np.einsum("kij,kj->ki", system.lower, way[:-1])
        product[:-1] += np.einsum("kji,kj->ki", system.lower, way[1:])
        products.append(product.ravel())
    found = np.array(products) @ np.array([way.ravel() for way in directions]).T
    wanted = slopes @ slopes.T
    scale = np.sqrt(np.diagonal(wanted))
    np.testing.assert_allclose(found / np.outer(scale, scale), wanted / np.outer(scale, scale),
                               atol=2e-5)  # fmt: skip

    residual = np.concatenate([t.whiten(t.residual).ravel() for t in here.terms])
    pull = np.array([np.sum(here.rhs * way) for way in directions])
    np.testing.assert_allclose(pull / scale, -(slopes @ residual) / scale,
                               atol=2e-5 * np.linalg.norm(residual))  # fmt: skip


# Where on the robot a reading was taken is not known exactly (equation 16).


def test_an_uncertain_arclength_is_as_honest_as_certain_noise_is_not():
    slip, seeds, honest, bold = 8e-3, 15, [], []
    time = np.linspace(0.0, 1.0, 11)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        place = np.full(time.size, LENGTH / 2)
        seen = arc(place + slip * rng.standard_normal(time.size), time)[:, :3, 3]
        seen += 3e-4 * rng.standard_normal(seen.shape)
        coil = PositionReadings(time=time, arclength=place, values=seen, cov=9e-8, name="coil")
        base = tracker(rng, "base", 0.0)
        for std, squares in ((slip, honest), (0.0, bold)):
            readings = [base, replace(coil, arclength_std=std)]
            at = estimate(SOFT, COARSE, readings).at(LENGTH / 2, 0.4)
            error = at.position - arc(LENGTH / 2, 0.4)[:3, 3]
            squares.append(error @ np.linalg.solve(at.cov_position_world, error))
    assert consistent(honest, 3 * seeds)
    assert np.mean(bold) / 3.0 > 10.0


def test_an_uncertain_arclength_adds_the_slope_along_the_robot_to_the_covariance():
    rng = np.random.default_rng(7)
    state = motion(rng, GRID)
    plain = scattered(rng)
    spread = rng.uniform(3e-2, 6e-2, 6)
    by_hand = []
    for r in plain:
        ends = [
            r.residual(states_at(prior(), GRID, state, r.arclength + h, r.time))
            for h in (1e-6, -1e-6)
        ]
        slope = (ends[0] - ends[1]) / 2e-6
        more = spread[:, None, None] ** 2 * slope[:, :, None] * slope[:, None, :]
        assert np.abs(more).max() > 0.1 * np.abs(r.cov).max()
        by_hand.append(replace(r, cov=r.cov + more))

    def system(readings):
        workspace = np.empty(system_shape(K, N * state.dof))
        found = linearize(prior(), locate(GRID, readings), state, state, workspace)
        return [found.system.diagonal, found.system.lower, found.rhs]

    told = system([replace(r, arclength_std=spread) for r in plain])
    unmoved = system([replace(r, arclength_std=0.0) for r in plain])
    for one, other, none, zero in zip(told, system(by_hand), system(plain), unmoved, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-7 * np.abs(other).max())
        np.testing.assert_array_equal(none, zero)
    assert np.abs(told[0] - system(plain)[0]).max() > 1e-3 * np.abs(told[0]).max()


@pytest.mark.parametrize("bad", [-1e-3, [1e-3, 1e-3], np.nan])
def test_an_arclength_std_that_makes_no_sense_is_refused(bad):
    reading = sliding_scene()[2][1]
    with pytest.raises(SensorError, match=r"coil: arclength_std must be one number from 0"):
        replace(reading, arclength_std=bad)
