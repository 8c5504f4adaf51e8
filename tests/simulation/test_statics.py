"""Static shapes against closed forms, a shooting oracle, another group's solver; and none."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, poses
from glissando.geometry import se3
from glissando.simulation import Loads, NoShapeError, Rod, Tendon, Wrench, solve_shape
from oracles import rods
from rods_drawn import LOADS, STRAIGHT, any_robot, beam

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


@pytest.mark.slow
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


@pytest.mark.parametrize("place", [0.0, 1e-17, 1e-10])
def test_a_load_on_the_clamped_base_does_nothing(place):
    rod = beam()
    shape = solve_shape(rod, [], Loads(wrenches=[Wrench(place, (1.0, 2, 3), (4.0, 5, 6))]))
    np.testing.assert_allclose(shape.at([0.0, 1.0]).strain, [STRAIGHT, STRAIGHT], atol=1e-12)


# ---- another way to the same shape ----


@pytest.mark.slow
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
        ([*LOADS, "bent"], 8),
        ([*LOADS, "curved"], 10),
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


@pytest.mark.parametrize("share", [0.9, 1.5, 4.0])
def test_a_column_beyond_its_critical_load_is_in_balance_where_it_would_not_stay(share):
    straight, top = solve_shape(beam(), [], Loads()), [0.0, 0.0, -share * EULER]
    loads = Loads(wrenches=[Wrench(1.0, top)])
    held = solve_shape(beam(), [], loads, start=straight, stable=False).at([0.0, 0.5, 1.0])
    np.testing.assert_allclose(held.wrench[:, :3], np.tile(top, (3, 1)), atol=1e-7)
    np.testing.assert_allclose(held.strain[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-9)


def test_a_column_pulled_up_never_buckles():
    np.testing.assert_allclose(column(tip=-100.0).at(1.0).pose, se3.exp(STRAIGHT), atol=1e-6)


@pytest.mark.parametrize("offset", [0.0, 5e-3])
def test_a_tension_far_too_large_says_how_much_would_do(offset):
    rod = beam(0.5, 0.02, stiff=500.0)
    with pytest.raises(NoShapeError, match=r"Under \d+\.\d % of these loads .*; reduce tensions"):
        solve_shape(rod, [Tendon(np.array([offset, 0.0]), 0.5)], Loads([1e5]))
