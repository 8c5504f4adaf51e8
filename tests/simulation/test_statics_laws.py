"""Laws that static shapes obey whatever the robot, and mistakes in describing one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from draws import generators, law, poses
from glissando.errors import SimulationError
from glissando.simulation import Loads, Rod, Tendon, Wrench, solve_shape
from oracles import rods
from rods_drawn import any_solved, beam, few

# ---- laws ----


@pytest.mark.slow
@few
@given(generators)
def test_a_moved_base_and_turned_loads_move_the_shape_rigidly(rng):
    rod, tendons, loads, shape = any_solved(rng)
    move = poses(rng)
    turn, s = move[:3, :3], np.linspace(0.0, rod.length, 25)
    moved_rod = Rod(
        rod.length, rod.stiffness, mass_per_length=rod.mass_per_length, base=move @ rod.base
    )
    wrenches = [Wrench(w.arclength, turn @ w.force, turn @ w.moment) for w in loads.wrenches]
    moved_loads = Loads(loads.tensions, turn @ loads.gravity, wrenches)
    moved = solve_shape(moved_rod, tendons, moved_loads).at(s)
    np.testing.assert_allclose(moved.pose, move @ shape.at(s).pose, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(moved.strain, shape.at(s).strain, rtol=0.0, atol=1e-8)


@few
@given(generators)
def test_two_tendons_in_one_place_are_one_tendon_under_their_sum(rng):
    rod, tendons, loads, shape = any_solved(rng)
    share = rng.uniform(size=len(tendons))
    tensions = np.concatenate([share * loads.tensions, (1.0 - share) * loads.tensions])
    split = Loads(tensions, loads.gravity, loads.wrenches)
    s = np.linspace(0.0, rod.length, 25)
    found = solve_shape(rod, [*tendons, *tendons], split).at(s)
    np.testing.assert_allclose(found.pose, shape.at(s).pose, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.wrench, shape.at(s).wrench, rtol=0.0, atol=1e-7)


@few
@given(generators)
def test_a_slack_tendon_and_a_weightless_load_only_cut_the_mesh(rng):
    rod, tendons, loads, shape = any_solved(rng)
    slack = Tendon(np.array([5e-3, 0.0]), rng.uniform(0.1, 1.0) * rod.length)
    more = Loads(
        [*loads.tensions, 0.0],
        loads.gravity,
        [*loads.wrenches, Wrench(rng.uniform(0.0, 1.0) * rod.length)],
    )
    s = np.linspace(0.0, rod.length, 25)
    found = solve_shape(rod, [*tendons, slack], more)
    for cut in (slack.end, more.wrenches[-1].arclength):
        assert np.abs(found.mesh.edges - cut).min() < 1e-12
    np.testing.assert_allclose(found.at(s).pose, shape.at(s).pose, rtol=0.0, atol=1e-6)


@few
@given(generators, st.floats(0.0, 1.0))
def test_a_warm_start_ends_in_the_same_shape_as_a_cold_one(rng, share):
    rod, tendons, loads, cold = any_solved(rng)
    wrenches = [Wrench(w.arclength, share * w.force, share * w.moment) for w in loads.wrenches]
    fewer = Loads(share * np.array(loads.tensions), share * loads.gravity, wrenches)
    near = solve_shape(rod, tendons, fewer)
    warm = solve_shape(rod, tendons, loads, start=near)
    s = np.linspace(0.0, rod.length, 25)
    np.testing.assert_allclose(warm.at(s).pose, cold.at(s).pose, rtol=0.0, atol=1e-9)


def test_a_start_whose_mesh_lacks_a_break_is_left_aside():
    rod, tendons, loads, cold = any_solved(np.random.default_rng(61))
    start = solve_shape(rod, [], Loads())
    warm = solve_shape(rod, tendons, loads, start=start)
    np.testing.assert_array_equal(warm.strain, cold.strain)


@pytest.mark.slow
@few
@given(generators)
def test_the_material_carries_the_loads_beyond_less_the_pull_of_the_tendons(rng):
    rod, tendons, loads, shape = any_solved(rng)
    breaks = [t.end for t in tendons] + [w.arclength for w in loads.wrenches]
    weight = rod.mass_per_length * loads.gravity
    step = 1e-3 * rod.length
    unit = rod.stiffness[3] * np.repeat([1 / rod.length**2, 1 / rod.length], 3)
    for s in rng.uniform(3.0 * step, rod.length - 3.0 * step, 5):
        if np.abs(np.array(breaks) - s).min() < 3.0 * step:
            continue  # no differences across a jump
        section = shape.at(s)
        turn, place = section.pose[:3, :3], section.pose[:3, 3]
        sigma = np.linspace(s, rod.length, 2000)
        arms = shape.at(sigma).pose[:, :3, 3] - place
        force = weight * (rod.length - s)
        moment = trapezoid(np.cross(arms, weight), sigma, axis=0)
        for w in loads.wrenches:
            if w.arclength > s:
                force = force + w.force
                arm = shape.at(w.arclength).pose[:3, 3] - place
                moment = moment + w.moment + np.cross(arm, w.force)
        around = s + step * np.array([-2, -1, 1, 2])
        for tendon, tension in zip(tendons, loads.tensions, strict=True):
            if tendon.end > s:
                near = shape.at(around).pose
                line = np.einsum("nij,nj->ni", near[:, :3, :3], tendon.path(around)[0])
                line += near[:, :3, 3]
                along = np.array([1.0, -8.0, 8.0, -1.0]) @ line
                pull = tension * along / np.linalg.norm(along)
                force = force - pull
                moment = moment - np.cross(turn @ tendon.path(np.array([s]))[0][0], pull)
        expected = np.concatenate([turn.T @ force, turn.T @ moment]) / unit
        tolerance = 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(section.wrench / unit, expected, rtol=0.0, atol=tolerance)


@law
@given(generators)
def test_tubes_are_as_stiff_and_heavy_as_their_rings_summed(rng):
    outer = np.sort(rng.uniform(1e-3, 5e-3, 3))
    diameters = [(wide, rng.uniform(0.0, 0.99) * wide) for wide in outer]
    rod = Rod.of_tubes(0.5, diameters, young=60e9, poisson=0.3, density=6450.0)
    area = polar = 0.0
    for wide, bore in diameters:
        edges = np.linspace(0.5 * bore, 0.5 * wide, 2001)
        middle, ring = 0.5 * (edges[1:] + edges[:-1]), np.pi * np.diff(edges**2)
        area += ring.sum()
        polar += np.sum(middle**2 * ring)
    shear = 60e9 / 2.6
    expected = [shear * area, shear * area, 60e9 * area]
    expected += [30e9 * polar, 30e9 * polar, shear * polar]
    np.testing.assert_allclose(rod.stiffness, expected, rtol=1e-6)
    assert rod.mass_per_length == pytest.approx(6450.0 * area)


@law
@given(generators)
def test_a_helical_tendons_slope_is_that_of_its_closed_form(rng):
    radius, angle, pitch, end = 8e-3, rng.uniform(-3, 3), rng.uniform(0.05, 1.0), 0.5
    s = rng.uniform(0.0, end, 20)
    place, slope = Tendon.helical(radius, angle, pitch, end).path(s)
    twin = rods.helical(radius, angle, pitch, 1.0, end)
    expected = np.array([twin.path(x) for x in s])
    np.testing.assert_allclose(place, expected[:, 0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(slope, expected[:, 1], rtol=0.0, atol=1e-9)


def test_sections_have_the_shape_of_the_query():
    rod, _, _, shape = any_solved(np.random.default_rng(62))
    s = np.linspace(0.0, rod.length, 6)
    flat, folded = shape.at(s), shape.at(s.reshape(2, 3))
    for name, each in (("pose", (4, 4)), ("strain", (6,)), ("wrench", (6,))):
        np.testing.assert_array_equal(
            getattr(folded, name), getattr(flat, name).reshape(2, 3, *each)
        )
        assert getattr(shape.at(s[2]), name).shape == each


# ---- mistakes ----

TENDON = Tendon(np.array([5e-3, 0.0]), 1.0)


def solve(tendons, tensions=(), **loads):
    return solve_shape(beam(), tendons, Loads(tensions, **loads))


@pytest.mark.parametrize(
    ("mistake", "sentence"),
    [
        (lambda: beam(0.0), "A rod of length 0 m cannot be; give metres > 0."),
        (lambda: beam(np.inf), "A rod of length inf m cannot be"),
        (lambda: beam(np.nan), "A rod of length nan m cannot be"),
        (lambda: Rod(1.0, np.ones(5)), r"stiffness is \[1.0, .*\]; give an array \(6,\) of finite"),
        (lambda: Rod(1.0, np.ones(6), np.ones(3)), r"rest_strain is .*; give an array \(6,\)"),
        (lambda: Rod(1.0, np.ones(6), mass_per_length=-1.0), "mass_per_length cannot be -1.0"),
        (lambda: Rod(1.0, np.ones(6), base=np.eye(3)), r"base is .*; give an array \(4, 4\)"),
        (lambda: solve([Tendon(np.zeros(3), 1.0)], [1.0]), r"offset is .*; give an array \(2,\)"),
        (lambda: Rod(1.0, -np.ones(6)), r"stiffness is \[-1.0, .*\]; give six numbers above zero"),
        (lambda: Rod(1.0, np.full(6, np.nan)), r"stiffness is .nan, .*finite numbers"),
        (
            lambda: Rod.of_tubes(1.0, [(1e-3, 2e-3)], young=1e9, poisson=0.3),
            "outer diameter 0.001 m and inner 0.002 m cannot be; give outer > inner",
        ),
        (
            lambda: Rod.of_tubes(1.0, [(2e-3, 1e-3), (1e-3, -1e-3)], young=1e9, poisson=0.3),
            "outer diameter 0.001 m and inner -0.001 m cannot be",
        ),
        (lambda: solve([TENDON]), "0 tensions for 1 tendons; give one a tendon, in newtons."),
        (lambda: solve([TENDON], [1.0, 2.0]), "2 tensions for 1 tendons"),
        (lambda: solve([TENDON], [-1.0]), r"\[-1.0\] N cannot be: a tendon only pulls; give numb"),
        (lambda: solve([TENDON], [np.nan]), r"Tensions \[nan\] N cannot be"),
        (lambda: solve([TENDON], [np.inf]), r"Tensions \[inf\] N cannot be"),
        (
            lambda: solve([Tendon(np.zeros(2), 1.1)], [1.0]),
            "A tendon ends at 1.1 m, off a rod of 1 m; end it on it.",
        ),
        (lambda: solve([Tendon(np.zeros(2), 0.0)], [1.0]), "A tendon ends at 0 m, off a rod"),
        (lambda: solve([Tendon(np.zeros(2), np.nan)], [1.0]), "A tendon ends at nan m, off a rod"),
        (
            lambda: solve([Tendon(np.zeros(2), 1.0, friction=-0.1)], [1.0]),
            "A tendon's friction of -0.1 cannot be; give a coefficient ≥ 0.",
        ),
        (lambda: solve([Tendon(np.zeros(2), 1.0, np.nan)], [1.0]), "A tendon's friction of nan"),
        (lambda: solve([], wrenches=[Wrench(1.1)]), "A load acts at 1.1 m, off a rod of 1 m; move"),
        (lambda: solve([], wrenches=[Wrench(-0.1)]), "A load acts at -0.1 m, off a rod"),
        (lambda: solve([], gravity=9.81), "A load is 9.81; give three finite numbers x, y, z."),
        (lambda: solve([], gravity=(0, 0, np.nan)), "A load is .*nan.*; give three finite numbers"),
        (lambda: solve([], wrenches=[Wrench(1.0, (1, 2))]), r"A load is \(1, 2\); give three"),
        (lambda: solve([], wrenches=[Wrench(1.0, moment=[np.inf] * 3)]), r"A load is \[inf, inf,"),
        (lambda: solve([]).at(1.1), "Arclength 1.1 m is off a rod of 1 m; give 0 to 1 m."),
        (lambda: solve([]).at([0.5, -0.1]), "Arclength -0.1 m is off a rod"),
    ],
)
def test_a_mistake_is_answered_with_a_sentence(mistake, sentence):
    with pytest.raises(SimulationError, match=sentence):
        mistake()


def test_loads_at_the_very_tip_are_on_the_rod():
    third = 0.1 + 0.2  # a little more than the length below
    rod = beam(0.3)
    shape = solve_shape(
        rod, [Tendon(np.zeros(2), third)], Loads([1.0], wrenches=[Wrench(third, (0.0, 0, 1))])
    )
    assert shape.mesh.edges[-1] == pytest.approx(0.3, abs=1e-12)
