"""Static shapes against closed forms, a shooting oracle, another group's solver, and laws."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp, trapezoid
from scipy.linalg import expm

from draws import directions, generators, law, poses, sixes
from glissando import se3
from glissando.simulate import (
    Loads,
    NoShapeError,
    Rod,
    SimulationError,
    Tendon,
    Wrench,
    solve_shape,
)
from glissando.simulate.mesh import Mesh, magnus
from glissando.simulate.statics import resample
from oracles import dense, rods
from sorosim import differences

DATA = Path(__file__).parents[1] / ".." / "shared" / "data"
STRAIGHT = np.array([0.0, 0, 1, 0, 0, 0])
LOADS = ("parallel", "helical", "gravity", "tip", "middle")
few = settings(law, max_examples=15)


@pytest.fixture(scope="session")
def sorosim():
    file = (DATA / "sorosim" / "spring_steel_statics.csv").resolve()
    if not file.is_file():
        pytest.skip("SoroSim's shapes are not beside the checkout")
    return file


def beam(length=1.0, bending=1.0, *, stiff=1e9, **more):
    """A rod that only bends."""
    return Rod(length, np.array([stiff, stiff, stiff, bending, bending, bending]), **more)


def any_robot(rng, *features):
    """A robot with these features, under loads that bend it by a radian or so, and its twin.

    Features are those of LOADS and "bent" or "curved", which is initial curvature, constant or
    not. Shear and extension are anything from soft to stiff.
    """
    length, bending = round(rng.uniform(0.3, 0.7), 3), 0.02 * rng.uniform(0.5, 2.0, 3)
    stiffness = np.append(10.0 ** rng.uniform(2.0, 4.5, 3), bending)
    force, moment = bending.min() / length**2, bending.min() / length
    rest, rod_rest = any_rest_strain(rng, features)
    base, mass = poses(rng), 0.03
    weight = rng.uniform(0.5, 2.5) * force / length * directions(rng) * ("gravity" in features)

    pulls, tendons = [], []
    for _ in range(3 * ("parallel" in features)):
        radius, angle = rng.uniform(4e-3, 9e-3), rng.uniform(-np.pi, np.pi)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        end, tension = place_on(rng, length, 0.2, 1.0), rng.uniform(0.1, 0.8) * moment / radius
        pulls.append(rods.straight(x, y, tension, end))
        tendons.append(Tendon(np.array([x, y]), end))
    for _ in range("helical" in features):
        radius, angle = rng.uniform(4e-3, 9e-3), rng.uniform(-np.pi, np.pi)
        end, tension = place_on(rng, length, 0.2, 1.0), rng.uniform(0.5, 1.2) * moment / radius
        pitch = rng.choice([-1.0, 1.0]) * length / rng.uniform(0.3, 2.0)
        pulls.append(rods.helical(radius, angle, pitch, tension, end))
        tendons.append(Tendon.helical(radius, angle, pitch, end))

    places = [length] * ("tip" in features)
    places += [place_on(rng, length, 0.3, 0.7)] * ("middle" in features)
    points = tuple(
        rods.Point(
            s,
            rng.uniform(0.3, 1.0) * force * directions(rng),
            rng.uniform(0.3, 1.0) * moment * directions(rng),
        )
        for s in places
    )
    rod = Rod(length, stiffness, rest_strain=rod_rest, mass_per_length=mass, base=base)
    loads = Loads([p.tension for p in pulls], weight / mass, [Wrench(*p) for p in points])
    twin = rods.Robot(length, stiffness, rest, base, weight, tuple(pulls), points)
    return rod, tendons, loads, twin


def place_on(rng, length, low, high):
    """A place on a rod, to the millimetre: the mesh rounds its edges, and a break is only there."""
    return round(length * rng.uniform(low, high), 3)


def any_rest_strain(rng, features):
    """Unloaded strain for the twin, (2, 6) at one s with its slope, and for the rod."""
    mean, swing, rate = STRAIGHT.copy(), np.zeros(6), 8.0
    if "bent" in features or "curved" in features:
        mean += sixes(rng, reach=0.02, angle=1.5)
    if "curved" in features:
        swing = sixes(rng, reach=0.02, angle=1.0)

    def twin(s):
        return np.array([mean + swing * np.sin(rate * s), rate * swing * np.cos(rate * s)])

    def rod(s):
        return mean + swing * np.sin(rate * s[:, None])

    return twin, rod if "curved" in features else mean


def any_solved(rng, *features):
    rod, tendons, loads, _ = any_robot(rng, *(features or LOADS))
    return rod, tendons, loads, solve_shape(rod, tendons, loads)


# ---- closed forms ----


@pytest.mark.parametrize("load", [0.1, 0.3, 1.0, 2.0, 4.0, 7.0, 10.0])
def test_a_cantilevers_tip_is_where_elliptic_integrals_put_it(load):
    length, bending = 0.6, 0.02
    force = load * bending / length**2
    rod = beam(length, bending)
    shape = solve_shape(rod, [], Loads(wrenches=[Wrench(length, (force, 0, 0))]))
    along, across = rods.elastica(load)
    expected = length * np.array([across, 0.0, along])
    error = np.abs(shape.at(length).pose[:3, 3] - expected).max()
    print(f"load {load}: {error / length:.1e} of the length")
    assert error < 1e-6 * length


@law
@given(generators)
def test_one_parallel_tendon_bends_a_rod_into_an_arc_and_leaves_it_straight_beyond(rng):
    rod, (tendon, *_), loads, _ = any_robot(rng, "parallel")
    bending = rod.stiffness[3]
    stiffness = np.append(rod.stiffness[:3], [bending, bending, rod.stiffness[5]])
    tension = loads.tensions[0]
    shape = solve_shape(Rod(rod.length, stiffness), [tendon], Loads([tension]))
    s = np.linspace(0.0, rod.length, 41)
    expected = rods.arc(rod.length, stiffness, tendon.offset, tension, tendon.end, s)
    np.testing.assert_allclose(shape.at(s).pose, expected, rtol=0.0, atol=1e-6 * rod.length)


@law
@given(generators, st.floats(0.05, 1.0))
def test_friction_lets_a_tendon_bend_a_rod_ever_less_towards_its_end(rng, friction):
    """From θ′ = c exp(−μ θ), c the curvature without friction: exp(μ θ) = 1 + μ c s."""
    length, radius, bend = 0.5, 6e-3, rng.uniform(0.5, 6.0)
    rod = beam(length, 0.02)
    tendon = Tendon(np.array([radius, 0.0]), length, friction)
    s = np.linspace(0.0, length, 21)
    found = solve_shape(rod, [tendon], Loads([bend * 0.02 / radius])).at(s)
    angle = np.log1p(friction * bend * s) / friction
    np.testing.assert_allclose(found.pose[:, 0, 2], np.sin(angle), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found.pose[:, 2, 2], np.cos(angle), rtol=0.0, atol=1e-6)
    curvature = bend / (1.0 + friction * bend * s)
    np.testing.assert_allclose(found.strain[:, 4], curvature, rtol=0.0, atol=1e-5)


@law
@given(generators)
def test_a_tendon_through_the_middle_shortens_a_rod_and_never_buckles_it(rng):
    rod = beam(0.5, 0.02, stiff=500.0)
    tension = rng.uniform(0.0, 0.9) * 500.0  # thousands of times what a dead force may be
    shape = solve_shape(rod, [Tendon(np.zeros(2), 0.5)], Loads([tension]))
    expected = [0.0, 0.0, 0.5 * (1.0 - tension / 500.0)]
    np.testing.assert_allclose(shape.at(0.5).pose[:3, 3], expected, atol=1e-9)


def test_an_unloaded_rod_has_its_rest_strain():
    rod, _, _, twin = any_robot(np.random.default_rng(60), "curved")
    s = np.linspace(0.0, rod.length, 30)
    strain = solve_shape(rod, [], Loads()).at(s).strain
    np.testing.assert_allclose(strain, [twin.rest(x)[0] for x in s], rtol=0.0, atol=1e-9)


def test_a_load_on_the_clamped_base_does_nothing():
    rod = beam()
    shape = solve_shape(rod, [], Loads(wrenches=[Wrench(0.0, (1.0, 2, 3), (4.0, 5, 6))]))
    np.testing.assert_allclose(shape.at([0.0, 1.0]).strain, [STRAIGHT, STRAIGHT], atol=1e-12)


# ---- another way to the same shape ----


@pytest.mark.parametrize(
    ("features", "seed"),
    [
        (["parallel"], 1),
        (["helical"], 2),
        (["gravity"], 3),
        (["tip"], 4),
        (["middle"], 5),
        (["bent", "parallel", "tip"], 6),
        (["curved", "helical", "gravity"], 7),
        *[([*LOADS, "bent"], seed) for seed in (8, 9)],
        *[([*LOADS, "curved"], seed) for seed in (10, 11, 12)],
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else str(value),
)
def test_a_robot_has_the_shape_that_shooting_finds(features, seed):
    rng = np.random.default_rng(seed)
    rod, tendons, loads, twin = any_robot(rng, *features)
    s = np.sort(np.append(rng.uniform(0.0, rod.length, 30), twin.breaks))
    expected = rods.rucker_webster(twin, s)
    found = solve_shape(rod, tendons, loads).at(s)
    carried = np.abs(expected.wrench / twin.unit).max()
    turned = np.degrees(np.arccos(expected.pose[-1, :3, 2] @ expected.pose[0, :3, 2]))
    errors = [
        np.abs(found.pose - expected.pose).max(),
        np.abs(found.strain - expected.strain).max(),
        np.abs((found.wrench - expected.wrench) / twin.unit).max() / carried,
    ]
    print(
        f"tip turned {turned:.0f} degrees; pose, strain, wrench off by",
        *map("{:.0e}".format, errors),
    )
    assert max(errors[:2]) < 1e-6
    assert errors[2] < 5e-6  # of the bending that is carried, from strains that cancel in it


@pytest.mark.slow
def test_five_hundred_shapes_of_another_groups_solver_are_ours(sorosim):
    distance, angle = differences(sorosim)
    tip = 1e3 * distance[:, -1]
    assert np.median(tip) < 0.15
    assert np.quantile(tip, 0.99) < 0.42
    assert 1e3 * distance.max() < 0.65
    assert np.degrees(angle.max()) < 0.35


# ---- laws ----


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
    near = solve_shape(rod, tendons, loads.scaled(share))
    warm = solve_shape(rod, tendons, loads, start=near)
    s = np.linspace(0.0, rod.length, 25)
    np.testing.assert_allclose(warm.at(s).pose, cold.at(s).pose, rtol=0.0, atol=1e-9)


def test_a_start_whose_mesh_lacks_a_break_is_left_aside():
    rod, tendons, loads, cold = any_solved(np.random.default_rng(61))
    start = solve_shape(rod, [], Loads())
    warm = solve_shape(rod, tendons, loads, start=start)
    np.testing.assert_array_equal(warm.strain, cold.strain)


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


def test_a_share_of_loads_is_a_share_of_every_one():
    loads = Loads([1.0, 2.0], (1.0, 2, 3), [Wrench(0.5, (4.0, 5, 6), (7.0, 8, 9))])
    half = loads.scaled(0.5)
    (wrench,) = half.wrenches
    for found, whole in (
        (half.tensions, loads.tensions),
        (half.gravity, loads.gravity),
        (wrench.force, (4, 5, 6)),
        (wrench.moment, (7, 8, 9)),
    ):
        np.testing.assert_array_equal(found, 0.5 * np.asarray(whole))
    assert wrench.arclength == 0.5


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


# ---- where there is no shape ----

EULER = np.pi**2 / 4.0  # P L² / EI of a column with a free tip
GREENHILL = 7.837347  # q L³ / EI of one under its own weight


def column(tip=0.0, weight=0.0, base=None):
    base = np.eye(4) if base is None else base
    rod = beam(mass_per_length=1.0, base=base)
    up = base[:3, 2]
    return solve_shape(rod, [], Loads(gravity=-weight * up, wrenches=[Wrench(1.0, -tip * up)]))


@pytest.mark.parametrize("load", [{"tip": EULER}, {"weight": GREENHILL}], ids=["tip", "weight"])
def test_a_column_stands_up_to_its_critical_load_and_no_further(load):
    base = poses(np.random.default_rng(63))

    def under(share):
        return column(**{name: share * value for name, value in load.items()}, base=base)

    for share in (0.5, 0.95, 0.999):
        strain = under(share).at(np.linspace(0.0, 1.0, 9)).strain
        np.testing.assert_allclose(strain, np.tile(STRAIGHT, (9, 1)), rtol=0.0, atol=1e-7)
    for share in (1.001, 1.05, 4.0, 30.0):
        with pytest.raises(NoShapeError, match=r"Under \d+\.\d % of these loads") as caught:
            under(share)
        percentage = float(re.search(r"[\d.]+", str(caught.value))[0])
        assert percentage == pytest.approx(100.0 / share, abs=0.2)


def test_a_column_pulled_up_never_buckles():
    np.testing.assert_allclose(column(tip=-100.0).at(1.0).pose, se3.exp(STRAIGHT), atol=1e-6)


@pytest.mark.parametrize("offset", [0.0, 5e-3])
def test_a_tension_far_too_large_says_how_much_would_do(offset):
    rod = beam(0.5, 0.02, stiff=500.0)
    with pytest.raises(NoShapeError, match=r"Under \d+\.\d % of these loads .*; reduce tensions"):
        solve_shape(rod, [Tendon(np.array([offset, 0.0]), 0.5)], Loads([1e5]))


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
        (lambda: Rod(1.0, np.ones(6), mass_per_length=-1.0), "A rod of -1 kg/m cannot be"),
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


# ---- the mesh ----

POINTS = 12  # an element


def any_mesh(rng):
    return Mesh.through(np.append(0.0, np.cumsum(rng.uniform(0.05, 0.3, 3))), 0.2)


def any_strain(rng):
    """A smooth function of arclength (M,) → (M, 6), bending by some radians a metre."""
    size, rate, phase = sixes(rng, reach=0.1, angle=4.0), rng.uniform(2, 6, 6), 6 * rng.random(6)
    return lambda s: STRAIGHT + size * np.sin(rate * np.asarray(s)[..., None] + phase)


def rolled_out(strain, s, steps=4000):
    """Pose (4, 4) at s from the base, by many short steps of constant strain."""
    middles = (np.arange(steps) + 0.5) * s / steps
    pose = np.eye(4)
    for move in expm(s / steps * np.array([dense.hat(e) for e in strain(middles)])):
        pose = pose @ move
    return pose


@law
@given(generators)
def test_a_mesh_has_an_edge_at_every_break_and_no_element_too_long(rng):
    breaks, largest = rng.uniform(0.0, 1.0, rng.integers(2, 8)), rng.uniform(0.01, 1.0)
    edges = Mesh.through([*breaks, *breaks], largest).edges
    assert np.abs(edges[:, None] - breaks).min(axis=0).max() < 1e-12
    assert np.diff(edges).max() <= largest + 1e-9
    assert np.diff(edges).min() > 0.0
    assert edges[[0, -1]] == pytest.approx([breaks.min(), breaks.max()], abs=1e-12)


@law
@given(generators)
def test_integrals_of_polynomials_are_exact_up_to_the_degree_that_the_points_determine(rng):
    mesh = any_mesh(rng)
    s, end = mesh.points / mesh.edges[-1], mesh.edges[-1]
    for degree in range(POINTS):
        found = mesh.integral @ s**degree
        np.testing.assert_allclose(found, end * s ** (degree + 1) / (degree + 1), atol=1e-14)
    for degree in range(2 * POINTS):  # Gauss's theorem, for the whole length
        assert mesh.weights @ s**degree == pytest.approx(end / (degree + 1), rel=1e-13)


@law
@given(generators)
def test_polynomials_are_interpolated_exactly_each_element_its_own(rng):
    mesh = any_mesh(rng)
    coefficients = rng.standard_normal((mesh.edges.size - 1, POINTS, 2))

    def values(x):
        element = np.searchsorted(mesh.edges[1:-1], x, side="right")
        powers = x[:, None] ** np.arange(POINTS)
        return np.einsum("mp,mpd->md", powers, coefficients[element])

    s = np.concatenate([rng.uniform(0.0, mesh.edges[-1], 20), mesh.edges])
    each = np.broadcast_to(values(mesh.points), (s.size, mesh.points.size, 2))
    np.testing.assert_allclose(mesh.interpolate(each, s), values(s), rtol=0.0, atol=1e-12)


@law
@given(generators)
def test_a_finer_mesh_takes_a_smooth_strain_over(rng):
    mesh, strain = any_mesh(rng), any_strain(rng)
    finer = Mesh.through(mesh.edges, 0.07)
    found = resample(mesh, strain(mesh.points), finer)
    np.testing.assert_allclose(found, strain(finer.points), rtol=0.0, atol=1e-9)


@few
@given(generators)
def test_strains_roll_out_into_poses_as_many_short_steps_do(rng):
    mesh, strains, bases = any_mesh(rng), [any_strain(rng) for _ in range(2)], poses(rng, 2)
    values = np.array([strain(mesh.points) for strain in strains])
    points, edges = mesh.roll_out(values, bases)
    s = np.concatenate([mesh.edges, mesh.points[::5], rng.uniform(0.0, mesh.edges[-1], 3)])
    for i, strain in enumerate(strains):
        each = [np.broadcast_to(x, (s.size, *x.shape)) for x in (values[i], edges[i])]
        anywhere = mesh.pose_at(*each, s)
        known = np.concatenate([edges[i], points[i, ::5]])
        np.testing.assert_allclose(anywhere[: len(known)], known, rtol=0.0, atol=1e-8)
        for k in (1, mesh.edges.size - 1, mesh.edges.size + 3, -1):
            expected = bases[i] @ rolled_out(strain, s[k])
            np.testing.assert_allclose(anywhere[k], expected, rtol=0.0, atol=1e-7)


def test_a_magnus_step_is_of_sixth_order():
    rng = np.random.default_rng(64)
    errors = {count: [] for count in (4, 8, 16)}
    for _ in range(10):
        strain, length = any_strain(rng), 1.0
        exact = solve_ivp(
            lambda s, y, strain=strain: (y.reshape(4, 4) @ dense.hat(strain(s))).ravel(),
            (0.0, length),
            np.eye(4).ravel(),
            method="DOP853",
            rtol=1e-13,
            atol=1e-14,
        ).y[:, -1]
        for count, error in errors.items():
            edges = np.linspace(0.0, length, count + 1)
            inner = 0.5 * (edges[1:] + edges[:-1])[:, None]
            inner = inner + 0.5 * length / count * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
            moves = se3.exp(magnus(strain(inner), np.full((count, 1), length / count)))
            found = np.linalg.multi_dot([np.eye(4), *moves])
            error.append(np.abs(found.ravel() - exact).max())
    sizes = [np.median(error) for error in errors.values()]
    orders = np.log2(np.array(sizes[:-1]) / sizes[1:])
    print("errors", *map("{:.1e}".format, sizes), "orders", orders.round(2))
    assert np.all(orders > 5.9)
