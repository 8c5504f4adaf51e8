"""The mechanical prior with inertia: slopes, modes, the limit of no mass, and its confidence."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import CoilReadings, FixedLagSmoother, estimate
from glissando.errors import NotConvergedWarning, OutsideGridError, UnobservableError
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.beam_modes import beam_modes
from glissando.model.priors.mechanical.inertia import Inertia
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Rod, Wrench
from glissando.simulation.dynamics import Scenario, TimedWrench, simulate_motion
from glissando.solver.block_tridiagonal import factor
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate
from glissando.solver.normal_equations import system_shape
from mechanical_rod import NODES_S, mechanical, moving
from oracles import separable as oracle
from slope import interpolation_slope_test, slope_test

GRID = Grid(NODES_S, [0.0, 0.01, 0.025])
NODES = GRID.shape[0] * GRID.shape[1]
SWING = Inertia(modes=3, retardation=4e-3, air_damping=1e-3, std_release=0.5)
WIRE = Rod.of_tubes(0.6, [(1.6e-3, 0.0)], young=200e9, poisson=0.33, density=7870, retardation=4e-3)
STD = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])


def swinging(rng, prior):
    """A random state of a rod that swings."""
    state = moving(rng, replace(prior, inertia=None), GRID)
    return replace(state, inertia=rng.standard_normal(state.strain.shape) * np.repeat([9, 99], 3))


def wire(**changes):
    """A steel wire with the loads of a tenth of its weight."""
    fields = {
        "mechanics": Mechanics(WIRE.stiffness[None], np.array([WIRE.mass_per_length])),
        "psd_load": np.repeat([1e-4, 1e-9], 3),
        "psd_strain_error": np.repeat([1e-9, 1e-5], 3),
        "var_tip": np.repeat([1e-5, 1e-9], 3),
        "time_scale": 0.1,
        "var_base": np.full(6, 1e-8),
        "inertia": replace(SWING, air_damping=0.0),
    }
    return MechanicalPrior(**(fields | changes))


def released(seconds, seed=0, force=0.2):
    """A wire let go at time zero: its motion, and a coil at its tip at 40 Hz."""
    pulled = TimedWrench(Wrench(0.6, force=[force, 0.5 * force, 0.0]), stop=0.0)
    motion = simulate_motion(WIRE, [], Scenario(wrenches=(pulled,)), duration=seconds)
    time = np.arange(0.0, seconds + 1e-9, 1 / 40)
    noise = np.random.default_rng(seed).standard_normal((time.size, 6)) * np.append(STD, STD[-1])
    pose = motion.at(0.6, time).pose @ se3.exp(noise)
    coil = CoilReadings(
        time=time, arclength=np.full(time.size, 0.6), values=pose, cov=STD**2, name="coil"
    )
    return motion, coil


def wire_grid(seconds, nodes=7, rate=80):
    return Grid(np.linspace(0.0, 0.6, nodes), np.arange(round(seconds * rate) + 1) / rate)


def test_every_factor_has_its_jacobian_and_names_its_nodes():
    prior = mechanical(inertia=SWING)
    state = swinging(np.random.default_rng(0), prior)
    where = np.broadcast_to(NODES_S, GRID.shape)
    soft, ones = 0.1 / prior.rod.wrench(state.strain, where)[1], np.ones((*GRID.shape, 6))
    scale = np.concatenate([ones, soft, ones, soft, ones * np.repeat([1, 30], 3)], axis=-1)

    def batches(at):
        return list(prior.factors(GRID, at, state, slice(0, 3)))

    found = batches(state)
    assert len(found) > 6 + 2 * SWING.modes
    slopes = [oracle.spread(b, NODES).reshape(-1, NODES * 30) * scale.ravel() for b in found]
    sizes = [1e3 * np.abs(slope).max() for slope in slopes]  # rounding is of the largest rows

    def moved(step):
        there = batches(state.retract(scale * step.reshape(scale.shape)))
        rows = zip(there, sizes, strict=True)
        return np.concatenate([batch.terms.residual.ravel() / size for batch, size in rows])

    slope_test(moved, np.concatenate([s / size for s, size in zip(slopes, sizes, strict=True)]))


def test_interpolation_has_its_jacobian():
    prior = mechanical(inertia=SWING)
    state = swinging(np.random.default_rng(1), prior)
    where = np.broadcast_to(NODES_S, GRID.shape)
    soft, ones = 0.1 / prior.rod.wrench(state.strain, where)[1], np.ones((*GRID.shape, 6))
    scale = np.concatenate([ones, soft, ones, soft, ones], axis=-1)
    interpolation_slope_test(prior, GRID, state, "cell", scale)


def test_modes_are_those_of_the_closed_form_cantilever():
    prior = wire()
    modes = beam_modes(prior.mechanics, np.linspace(0, 0.6, 9), 4, (1e-4, 0.0), (np.zeros(0),) * 2)
    roots = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349])  # cos x cosh x = −1
    beam = (roots / 0.6) ** 2 * np.sqrt(WIRE.stiffness[3] / WIRE.mass_per_length)
    np.testing.assert_allclose(modes.rate, beam, rtol=1e-6)
    np.testing.assert_allclose(modes.at_tip**2, 4.0 / (0.6 * WIRE.mass_per_length), rtol=1e-6)


def test_too_few_nodes_for_the_modes_are_refused():
    prior, grid = wire(), wire_grid(0.05, nodes=3)
    with pytest.raises(OutsideGridError, match="3 modes needs 4 arclength nodes"):
        estimate(prior, grid, [released(0.05)[1]])


def test_a_rod_of_no_mass_is_answered_as_without_inertia():
    _, coil = released(0.1, force=0.02)
    grid, light = (
        wire_grid(0.1, nodes=5),
        replace(wire().mechanics, mass_per_length=np.array([1e-9])),
    )
    with_inertia = wire(mechanics=light, inertia=replace(SWING, air_damping=0.0, std_release=1e-8))
    exact = SolverOptions(tolerance=1e-3)
    answers = [
        estimate(prior, grid, [coil], options=exact).at(grid.arclength, grid.time[:, None])
        for prior in (with_inertia, replace(with_inertia, inertia=None))
    ]
    one, other = answers
    gap = np.linalg.norm(one.position - other.position, axis=-1)
    assert gap.max() < 1e-3 * other.std_position.max()
    std = [np.sqrt(np.einsum("...ii->...i", each.cov[..., 1:, :12, :12])) for each in answers]
    np.testing.assert_allclose(*std, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("inflate", "draws", "honest"), [(1.0, 60, True), (1.5, 20, False)])
def test_errors_of_drawn_motions_are_as_large_as_stated(inflate, draws, honest):
    """Positions of three nodes at all times; loads so small that motions are linear.

    Motions that are half as large again as stated are found.
    """
    swing = replace(SWING, air_damping=0.0, std_release=0.01)
    loads = {"psd_load": np.repeat([1e-5, 1e-10], 3), "var_tip": np.repeat([1e-6, 1e-10], 3)}
    prior, grid = wire(**loads, inertia=swing), wire_grid(0.1, nodes=6)
    rng, nodes = np.random.default_rng(7), [2, 3, 5]
    rest, read = prior.rest_state(grid), np.arange(0, grid.time.size, 2)
    memory = np.empty(system_shape(grid.time.size, rest.numbers))
    drawn = factor(linearize(prior, locate(grid, []), rest, rest, memory).system)
    found = []
    for _ in range(draws):
        step = inflate * drawn.sample(rng).reshape(*grid.shape, -1)
        truth = prior.retract_strains(grid, rest, step)
        noise = rng.standard_normal((read.size, 6)) * np.append(STD, STD[-1])
        where = {"time": grid.time[read], "arclength": np.full(read.size, 0.6)}
        coil = CoilReadings(
            **where, values=truth.pose[read, -1] @ se3.exp(noise), cov=STD**2, name="coil"
        )
        posterior = estimate(prior, grid, [coil], gate=None)
        at = posterior.at(grid.arclength[nodes], grid.time[1:, None])
        gap = at.position - truth.pose[1:, nodes][..., :3, 3]
        inverse = np.linalg.inv(at.cov_position_world)
        found.append(np.mean(np.einsum("kni,knij,knj->kn", gap, inverse, gap)) / 3.0)
    assert (abs(np.mean(found) - 1.0) < 0.25) == honest


def followed(smoother, grid, coil):
    """The newest states of a smoother at the time nodes, as the coil's readings come."""
    states, before = [], -1.0
    for now in grid.time:
        smoother.add(coil.select((coil.time > before) & (coil.time <= now)))
        states.append(smoother.advance(float(now)))
        before = now
    return states


@pytest.mark.slow
def test_a_smoother_with_a_long_window_says_what_the_batch_says():
    _, coil = released(0.1)
    grid = wire_grid(0.1, nodes=5)
    smoother = FixedLagSmoother(wire(), grid.arclength, window=99, gate=None)
    followed(smoother, grid, coil)
    smoother.iterate(tolerance=1e-7)
    batch = estimate(wire(), grid, [coil], options=SolverOptions(tolerance=1e-5), gate=None)
    one, other = (
        each.at(grid.arclength[1:], grid.time[:, None]) for each in (smoother.posterior(), batch)
    )
    gap = np.linalg.norm(one.position - other.position, axis=-1)
    assert np.all(gap < 1e-3 * other.std_position)
    np.testing.assert_allclose(one.std_position, other.std_position, rtol=1e-3)


@pytest.mark.slow
def test_a_smoother_follows_a_rod_that_is_let_go_without_beginning_again():
    motion, coil = released(0.3)
    grid = wire_grid(0.3)
    smoother = FixedLagSmoother(wire(), grid.arclength, window=4, gate=None)
    states = followed(smoother, grid, coil)[5:]  # two readings show no velocity yet
    assert smoother.restarts == 0
    truth = motion.at(0.3, grid.time[5:]).pose[:, :3, 3]
    gap = np.array([at.position[3] for at in states]) - truth
    cov = np.array([at.cov_position_world[3] for at in states])
    assert np.sqrt(np.mean(gap**2)) < 0.7e-3
    assert np.mean(np.einsum("mi,mij,mj->m", gap, np.linalg.inv(cov), gap)) / 3.0 < 1.6


def tightened():
    """A prior of hardly any loads, its problem, and where one of larger loads ends."""
    _, coil = released(0.5)
    grid = wire_grid(0.5, nodes=9)
    swing = replace(SWING, modes=4, air_damping=0.0)
    force, tip = 8e-7 * np.repeat([1.0, 4e-5], 3), 8e-8 * np.repeat([1.0, 4e-5], 3)
    fields = {"psd_strain_error": np.repeat([1e-9, 1e-6], 3), "var_base": np.full(6, 1e-9)}
    first, last = (
        wire(psd_load=part * force, var_tip=part * tip, inertia=swing, **fields) for part in (64, 1)
    )
    return last, grid, coil, estimate(first, grid, [coil], gate=None).state


@pytest.mark.slow
def test_a_start_that_looser_loads_found_is_a_few_steps_from_the_end():
    prior, grid, coil, start = tightened()
    posterior = estimate(prior, grid, [coil], gate=None, initial=start)
    assert posterior.solve.converged
    assert posterior.solve.iterations <= 5


@pytest.mark.slow
def test_a_second_step_that_nothing_determines_is_left_out(monkeypatch):
    asked = []

    def singular(system, **options):
        asked.append(system)
        raise UnobservableError("there")

    prior, grid, coil, start = tightened()
    monkeypatch.setattr("glissando.solver.step_search.factor", singular)
    with pytest.warns(NotConvergedWarning):
        estimate(
            prior, grid, [coil], gate=None, initial=start, options=SolverOptions(max_iterations=2)
        )
    assert asked


@pytest.mark.slow
def test_a_coil_at_the_tip_shows_the_middle_of_a_rod_that_is_let_go():
    motion, coil = released(0.5)
    grid = wire_grid(0.5)
    posterior = estimate(wire(), grid, [coil])
    time = np.linspace(0.0, 0.5, 51)
    found, truth = posterior.at(0.3, time), motion.at(0.3, time)
    gap = found.position - truth.pose[:, :3, 3]
    nees = np.einsum("mi,mij,mj->m", gap, np.linalg.inv(found.cov_position_world), gap) / 3.0
    assert np.sqrt(np.mean(gap**2)) < 0.7e-3
    assert nees.mean() < 1.6
    finer = estimate(wire(), wire_grid(0.5, rate=160), [coil]).at(0.3, time)
    denser = estimate(wire(), wire_grid(0.5, nodes=13), [coil]).at(0.3, time)
    for other in (finer, denser):
        ratio = other.std_position[10:-10] / found.std_position[10:-10]
        assert np.abs(np.mean(ratio) - 1.0) < 0.03
