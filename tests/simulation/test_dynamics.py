"""Rods that move: closed forms, statics as the limit, balances, invariance, order, contacts."""

import numpy as np
import pytest
from hypothesis import given, settings

from draws import directions, generators, law, poses
from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.simulation import Loads, Rod, Tendon, Wrench, solve_shape
from glissando.simulation.dynamics import (
    BaseMotion,
    HalfSpace,
    Hold,
    Scenario,
    TimedWrench,
    simulate_motion,
)
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod_equations import AppliedLoads, RodEquations
from glissando.simulation.rod_mechanics import matrices, natural_frequencies
from rods_drawn import any_robot

BEAM = (1.8751040687, 4.6940911330)  # cos x cosh x = −1
few = settings(law, max_examples=2)


def wire(base=None, **damping):
    """A steel wire of 0.6 m and 1.6 mm."""
    material = {"young": 200e9, "poisson": 0.33, "density": 7870.0}
    return Rod.of_tubes(0.6, [(1.6e-3, 0.0)], base=base, **material, **damping)


def soft(retardation=0.02, base=None):
    """A rod none of whose slow vibrations is much faster than another."""
    stiffness, rotary = np.array([20.0, 20, 40, 0.05, 0.05, 0.04]), np.array([1e-4, 1e-4, 2e-4])
    base = np.eye(4) if base is None else base
    more = {"rotary_inertia": rotary, "retardation": retardation}
    return Rod(0.5, stiffness, mass_per_length=0.1, base=base, **more)


def at_rest(rod, tendons=()):
    equations = RodEquations.of(rod, tendons, Mesh.through([0.0, rod.length], 0.5 * rod.length))
    still = np.zeros_like(equations.rest)
    instant = AppliedLoads(rod.base, np.zeros(3), np.zeros((len(tendons), 4)))
    return equations, equations.at(np.stack([equations.rest, still, still]), instant), instant


def test_a_clamped_wire_vibrates_as_closed_forms_say():
    rod = wire()
    found = natural_frequencies(*at_rest(rod))
    speed = np.sqrt(rod.stiffness / rod.mass_per_length)
    bending = [(x / rod.length) ** 2 * speed[3] / (2.0 * np.pi) for x in BEAM]
    np.testing.assert_allclose(found[[0, 1, 2, 3]], np.repeat(bending, 2), rtol=1e-3)
    twisting = np.sqrt(rod.stiffness[5] / rod.rotary_inertia[2]) / (4.0 * rod.length)
    stretching = speed[2] / (4.0 * rod.length)
    for frequency in (twisting, stretching):
        assert np.abs(found / frequency - 1.0).min() < 1e-6


def any_state(rng, equations):
    """Strains near rest with smooth derivatives by time (3, G, 6)."""
    s = equations.mesh.points[:, None] / equations.rod.length
    waves = [np.sin(rng.uniform(2, 6, 6) * s + 6.0 * rng.random(6)) for _ in range(3)]
    return np.stack([equations.rest + 0.3 * waves[0], waves[1], waves[2]])


@few
@given(generators)
def test_mass_damping_and_stiffness_are_slopes_of_the_balance(rng):
    rod = soft()
    tendons = [Tendon(np.array([5e-3, 2e-3]), 0.5)]
    equations, _, instant = at_rest(rod, tendons)
    cables = np.array([[3.0, 50.0, 0.5, 0.0]])
    plane = np.array([[0.0, 0, 0.1, 0, 0, -1.0, 40.0, 0.5, 0.0]])
    held = np.array([[1.0, *np.zeros(6), 0.1, 0.2, 0.3, 7.0, 0.4]])
    instant = AppliedLoads(rod.base, instant.gravity, cables, held, plane)
    state = any_state(rng, equations)
    state[1:] = 0.0  # slopes leave the velocities and accelerations of inertia out
    slopes = matrices(equations, equations.at(state, instant), instant)
    weights, step = equations.mesh.weights[:, None], 1e-6
    for k, slope in enumerate((slopes.stiffness, slopes.damping, slopes.mass)):
        way, size = rng.standard_normal(equations.rest.shape), np.zeros((3, 1, 1))
        size[k] = step
        ahead, behind = (equations.at(state + sign * size * way, instant) for sign in (1, -1))
        slid = (weights * (ahead.residual - behind.residual)).ravel() / (2.0 * step)
        expected = slope @ way.ravel()
        assert np.abs(slid - expected).max() < 1e-4 * np.abs(expected).max()


@few
@given(generators)
def test_a_robot_that_is_let_be_stays_in_its_static_shape(rng):
    rod, tendons, loads, _ = any_robot(rng, "parallel", "gravity", "tip", "middle")
    shape = solve_shape(rod, tendons, loads)
    wrenches = tuple(TimedWrench(wrench) for wrench in loads.wrenches)
    motion = simulate_motion(
        rod, tendons, Scenario(loads.tensions, gravity=loads.gravity, wrenches=wrenches), 0.5
    )
    s = np.linspace(0.0, rod.length, 13)
    found = motion.at(s, 0.5)
    np.testing.assert_allclose(found.pose, shape.at(s).pose, rtol=0.0, atol=1e-8)
    assert np.abs(found.velocity).max() < 1e-6


@pytest.mark.slow
def test_a_damped_robot_comes_to_rest_in_the_static_shape_of_its_new_loads():
    rng = np.random.default_rng(5)
    rod = soft(0.3)
    tendons = [Tendon(np.array([5e-3, 0.0]), 0.5), Tendon(np.array([0.0, 5e-3]), 0.3, 0.1)]
    loads = Loads([2.0, 1.5], [0.5, 0.0, -1.0], [Wrench(0.5, 0.05 * directions(rng))])
    wrench = TimedWrench(loads.wrenches[0], start=0.1)

    def tensions(time):
        return np.array(loads.tensions) * min(time / 0.5, 1.0)

    scenario = Scenario(tensions, gravity=loads.gravity, wrenches=(wrench,), jumps=(0.5,))
    motion = simulate_motion(rod, tendons, scenario, 25.0)
    s = np.linspace(0.0, rod.length, 13)
    static = solve_shape(rod, tendons, loads)
    np.testing.assert_allclose(motion.at(s, 25.0).pose, static.at(s).pose, rtol=0.0, atol=1e-8)


@few
@given(generators)
def test_a_turned_world_turns_the_motion(rng):
    rod, move = soft(), poses(rng)
    turn, force, gravity = move[:3, :3], 0.1 * directions(rng), 3.0 * directions(rng)

    def motion(rod, turn):
        wrench = TimedWrench(Wrench(rod.length, turn @ force), stop=0.0)
        scenario = Scenario(gravity=turn @ gravity, wrenches=(wrench,))
        return simulate_motion(rod, [], scenario, 0.3, step=0.02, tolerance=1e-9)

    s, time = np.linspace(0.0, 0.5, 5), 0.27
    plain, moved = motion(rod, np.eye(3)).at(s, time), motion(soft(base=move), turn).at(s, time)
    np.testing.assert_allclose(moved.pose, move @ plain.pose, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(moved.velocity, plain.velocity, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(moved.specific_force, plain.specific_force, rtol=0.0, atol=1e-5)


def busy(rng):
    """A scenario in which everything acts, and its tendons."""
    pose = np.stack([np.eye(4), se3.exp(np.r_[0.05 * directions(rng), 0.5 * directions(rng)])])
    tendons = [Tendon(np.array([5e-3, 0.0]), 0.4)]
    return tendons, Scenario(
        displacements=lambda time: np.array([0.004 * np.sin(5.0 * time) ** 2]),
        tendon_stiffness=[300.0],
        gravity=3.0 * directions(rng),
        wrenches=(TimedWrench(Wrench(0.3, 0.05 * directions(rng)), start=0.05, stop=0.2),),
        half_spaces=(HalfSpace([0, 0, 0.45], [0, 0, -1], 100.0, 1.0, 0.3),),
        holds=(Hold(0.5, 20.0, 0.1, start=0.1, stop=0.25),),
        base=BaseMotion(np.array([0.0, 0.3]), pose),
    )


@pytest.mark.slow
@few
@given(generators)
def test_energy_is_what_was_supplied_less_what_was_lost(rng):
    tendons, scenario = busy(rng)
    motion = simulate_motion(soft(), tendons, scenario, 0.4, tolerance=1e-6)
    energies = motion.energies
    size = max(np.ptp(energies.total), np.abs(energies.supplied).max())
    assert np.abs(energies.imbalance).max() < 1e-3 * size
    assert np.all(np.diff(energies.dissipated) <= 1e-12)
    assert np.abs(energies.contact).max() > 0.0


@few
@given(generators)
def test_momentum_changes_as_weight_and_the_base_push(rng):
    rod, gravity = soft(), 3.0 * directions(rng)
    wrench = TimedWrench(Wrench(0.5, 0.1 * directions(rng)), stop=0.0)
    scenario = Scenario(gravity=gravity, wrenches=(wrench,))
    motion = simulate_motion(rod, [], scenario, 0.3, tolerance=1e-7)
    points, weights = motion.mesh.points, motion.mesh.weights

    def momentum(time):
        at = motion.at(points, time)
        world = np.einsum("gij,gj->gi", at.pose[:, :3, :3], at.velocity[:, :3])
        return rod.mass_per_length * weights @ world

    time, step = rng.uniform(0.1, 0.2), 1e-3
    gain = (momentum(time + step) - momentum(time - step)) / (2.0 * step)
    at = motion.at(points, time)
    turn, felt = at.pose[:, :3, :3], at.specific_force
    pushed = rod.mass_per_length * weights @ (np.einsum("gij,gj->gi", turn, felt) + gravity)
    np.testing.assert_allclose(gain, pushed, rtol=0.0, atol=2e-3 * np.abs(gain).max())


@pytest.mark.slow
def test_the_undamped_wire_keeps_its_energy_for_a_hundred_periods():
    rod, period = wire(), 1.0 / 3.134
    bent = solve_shape(rod, [], Loads(gravity=[9.81, 0, 0]))  # and then weightless
    start, step = (bent.strain, np.zeros_like(bent.strain)), period / 16
    motion = simulate_motion(
        rod, [], Scenario(), 100 * period, start=start, mesh=bent.mesh, method="gauss", step=step
    )
    total = motion.energies.total
    drift = np.abs(total[1:] / total[0] - 1.0).max()
    print(f"energy drift over 100 periods: {drift:.1e}")
    assert drift < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("method", "retardation", "order"), [("radau", 0.02, 4.5)])
def test_halving_steps_shrinks_errors_by_the_order_of_the_method(method, retardation, order):
    pose = np.stack([np.eye(4), se3.exp(np.array([0.1, 0.05, 0.1, 0.4, 0.3, 0.6]))])
    scenario = Scenario(gravity=[1.0, 2, 0], base=BaseMotion(np.array([0.0, 0.4]), pose))

    def tip(count):
        motion = simulate_motion(
            soft(retardation), [], scenario, 0.4, step=0.4 / count, method=method, tolerance=1e-9
        )
        return motion.at(0.5, 0.4).pose[:3, 3]

    exact = tip(96)
    errors = [np.abs(tip(count) - exact).max() for count in (12, 24)]
    found = np.log2(errors[0] / errors[1])
    print(f"{method}: errors {errors}, order {found:.2f}")
    assert found > order


def test_an_accelerometer_on_a_rigid_base_feels_gravity_and_what_the_base_does():
    pose = np.stack([np.eye(4), se3.exp(np.array([0.2, 0.0, 0.1, 0.5, 0.0, 0.4]))])
    base, gravity = BaseMotion(np.array([0.0, 1.0]), pose), np.array([0.0, 0.0, -9.81])
    motion = simulate_motion(soft(), [], Scenario(gravity=gravity, base=base), 1.0)
    step = 1e-4
    for time in (0.2, 0.5, 0.83):
        at = motion.at(0.0, time)
        before, here, after = (base.at(time + k * step)[0] for k in (-1, 0, 1))
        gained = (after - 2.0 * here + before)[:3, 3] / step**2
        np.testing.assert_allclose(at.pose, here, atol=1e-12)
        np.testing.assert_allclose(
            at.specific_force, here[:3, :3].T @ (gained - gravity), atol=1e-5
        )
        turned = se3.log(se3.inverse(before) @ after) / (2.0 * step)
        np.testing.assert_allclose(at.velocity, turned, atol=1e-6)


def test_a_soft_floor_carries_a_rod_that_falls_on_it_and_a_hold_lets_go():
    lie = np.eye(4)
    lie[:3, :3] = se3.so3_exp(np.array([0.0, np.pi / 2.0, 0.0]))
    floor = HalfSpace([0, 0, -0.02], [0, 0, 1], 500.0, 2.0, 0.2)
    scenario = Scenario(
        gravity=[0, 0, -9.81], half_spaces=(floor,), holds=(Hold(0.5, 50.0, 0.5, stop=0.2),)
    )
    motion = simulate_motion(soft(0.05, lie), [], scenario, 4.0)
    height = motion.at(motion.mesh.points, 4.0).pose[:, 2, 3]
    pushed = 500.0 * motion.mesh.weights @ np.maximum(-0.02 - height, 0.0)
    assert pushed > 0.1
    weight = 0.1 * 0.5 * 9.81
    assert pushed - motion.base_wrench[-1, 2] == pytest.approx(weight, rel=1e-6)
    assert motion.energies.kinetic[-1] < 1e-8
    static = motion.at(0.5, [0.0, 0.19]).pose[:, 2, 3]
    assert np.ptp(static) < 1e-6


def test_loads_and_holds_at_the_clamped_base_do_nothing():
    """Less than a rounding error beyond it, too."""
    loads = (TimedWrench(Wrench(1e-17, (0.0, 1.0, 0.0)), start=0.01),)
    holds = (Hold(1e-17, 50.0, place=(0.1, 0.0, 0.0), start=0.01),)
    motion = simulate_motion(soft(), [], Scenario(wrenches=loads, holds=holds), 0.05)
    np.testing.assert_allclose(motion.at(0.5, 0.05).pose[:3, 3], [0.0, 0.0, 0.5], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"duration": -1.0}, "A motion of -1 s cannot be"),
        ({"tolerance": 0.5}, "A tolerance of 0.5 cannot be"),
        ({"method": "euler"}, "no method 'euler'"),
        ({"method": "gauss"}, "does not choose its steps"),
        ({"rod": Rod(0.5, np.ones(6))}, "without mass"),
        ({"scenario": Scenario([1.0])}, "1 tensions for 0 tendons"),
        ({"scenario": Scenario(holds=(Hold(0.9, 1.0),))}, "off a rod of 0.5 m"),
        ({"scenario": Scenario(holds=(Hold(0.5, -1.0),))}, "hold's stiffness is -1"),
        (
            {"scenario": Scenario(half_spaces=(HalfSpace([0, 0, 0], [0, 0, 0], 1.0),))},
            "half-space's normal",
        ),
    ],
)
def test_an_impossible_motion_is_one_sentence(change, sentence):
    given = {"rod": soft(), "tendons": [], "scenario": Scenario(), "duration": 0.1}
    with pytest.raises(SimulationError, match=sentence):
        simulate_motion(**{**given, **change})


def test_a_mesh_without_an_edge_where_something_acts_is_refused():
    """The load would act at the nearest edge."""
    rod = Rod.of_tubes(0.5, [(2e-3, 1.8e-3)], young=60e9, poisson=0.33, density=6450.0)
    scenario = Scenario(wrenches=(TimedWrench(Wrench(0.2, (0.1, 0.0, 0.0))),))
    with pytest.raises(SimulationError, match="no edge wherever something acts"):
        simulate_motion(rod, (), scenario, 0.01, mesh=Mesh.through([0.0, 0.5], 0.25))
