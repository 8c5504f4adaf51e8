"""The Gauss points along a rod: integrals, interpolation, strains rolled out into poses."""

import numpy as np
import pytest
from hypothesis import given
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from draws import generators, law, poses, sixes
from glissando.geometry import se3
from glissando.simulation.mesh import Mesh, magnus
from glissando.simulation.statics import resample
from oracles import dense
from rods_drawn import STRAIGHT, few

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


@pytest.mark.slow
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
