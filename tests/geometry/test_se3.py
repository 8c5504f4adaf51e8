import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import directions, generators, law, poses, sixes
from glissando.geometry import se3
from oracles import dense
from slope import slope_test

SWITCH = 1.0  # angle at which power series give way to closed forms
ANGLES = [0.0, 1e-300, 1e-9, 1e-5, 1e-3, 0.3, SWITCH - 1e-9, SWITCH, SWITCH + 1e-9, 2.0, 3.0]
NEAR_PI = [np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi]
angles = st.floats(0.0, 3.0)


def close(a, b, tolerance=1e-13):
    scale = max(1.0, float(np.abs(b).max()))
    np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance * scale)


@law
@given(generators)
def test_poses_are_a_group(rng):
    a, b, c = poses(rng, 3)
    close((a @ b) @ c, a @ (b @ c))
    close(a @ se3.inverse(a), np.eye(4))
    close(se3.inverse(a) @ a, np.eye(4))
    close(se3.pose(a[..., :3, :3], a[..., :3, 3]), a)
    close(se3.inverse(a @ b), se3.inverse(b) @ se3.inverse(a))
    close(se3.inverse(se3.inverse(a)), a)


@law
@given(generators)
def test_products_of_exponentials_stay_rigid(rng):
    pose = np.linalg.multi_dot(list(poses(rng, 6)))
    close(pose[:3, :3].T @ pose[:3, :3], np.eye(3), 1e-14)
    assert np.linalg.det(pose) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])


@law
@given(generators, angles, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_motions_about_one_screw_add_up(rng, angle, a, b):
    x = sixes(rng, angle=angle)
    close(se3.exp(a * x) @ se3.exp(b * x), se3.exp((a + b) * x))
    close(se3.inverse(se3.exp(x)), se3.exp(-x))


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_exp_is_the_matrix_exponential(angle):
    for x in sixes(np.random.default_rng(1), 10, angle=angle):
        close(se3.exp(x), dense.exp(x))


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_log_undoes_exp_at_every_angle_up_to_pi(angle):
    x = sixes(np.random.default_rng(2), 200, angle=angle)
    back = se3.log(se3.exp(x))
    close(np.linalg.norm(back[:, 3:], axis=-1), angle, 1e-15)
    if angle == np.pi:  # both ends of the axis give this pose, so compare poses
        close(se3.exp(back), se3.exp(x))
    else:
        close(back, x, 1e-14)


def test_log_of_a_half_turn_about_each_axis_and_diagonal():
    axes = np.array([v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)], dtype=float) - 1.0
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    rotation = 2.0 * axes[:, :, None] * axes[:, None, :] - np.eye(3)  # exact half turns
    found = se3.so3_log(rotation)
    close(np.linalg.norm(found, axis=-1), np.pi, 1e-15)
    close(np.abs(np.sum(found * axes, axis=-1)), np.pi, 1e-15)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 1.0, 2.0, 2.9])
def test_log_is_the_matrix_logarithm(angle):
    for x in sixes(np.random.default_rng(3), 5, angle=angle):
        close(se3.log(dense.exp(x)), dense.log(dense.exp(x)), 1e-11)


@law
@given(generators, angles)
def test_quaternions_carry_the_whole_rotation(rng, angle):
    rotation = se3.so3_exp(angle * directions(rng, 20))
    q = se3.quaternion(rotation)
    assert np.all(q[:, 0] >= 0.0)
    close(np.linalg.norm(q, axis=-1), 1.0, 1e-15)
    close(se3.rotation_from_quaternion(q), rotation, 1e-14)
    close(se3.rotation_from_quaternion(-3.0 * q), rotation, 1e-14)


@law
@given(generators)
def test_the_adjoint_carries_twists_between_frames(rng):
    a, b = poses(rng, 2)
    x = sixes(rng)
    close(se3.adjoint(a), dense.adjoint(a))
    close(se3.adjoint(a) @ se3.adjoint(b), se3.adjoint(a @ b))
    close(a @ se3.exp(x) @ se3.inverse(a), se3.exp(se3.adjoint(a) @ x), 1e-12)


@law
@given(generators, angles)
def test_ad_generates_the_adjoint(rng, angle):
    x, y, z = sixes(rng, angle=angle), sixes(rng), sixes(rng)
    close(se3.hat(x), dense.hat(x), 0.0)
    close(se3.ad(x), dense.ad(x))
    close(se3.adjoint(se3.exp(x)), dense.adjoint_exp(x))
    close(se3.ad(x) @ y, -se3.ad(y) @ x)
    jacobi = [se3.ad(a) @ se3.ad(b) @ c for a, b, c in ((x, y, z), (y, z, x), (z, x, y))]
    close(sum(jacobi), np.zeros(6))


@law
@given(generators, angles)
def test_powers_of_ad_beyond_the_fourth_repeat(rng, angle):
    ad = se3.ad(sixes(rng, angle=angle))
    powers = [np.linalg.matrix_power(ad, k) for k in range(6)]
    close(powers[5], -2.0 * angle**2 * powers[3] - angle**4 * powers[1], 1e-12)


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_right_jacobian_is_its_power_series(angle):
    for x in sixes(np.random.default_rng(4), 10, angle=angle):
        series = dense.right_jacobian(x)
        close(se3.right_jacobian(x), series)
        close(se3.right_jacobian_inverse(x), np.linalg.inv(series), 1e-12)
        close(se3.left_jacobian_inverse(x), np.linalg.inv(dense.right_jacobian(-x)), 1e-12)


@law
@given(generators, angles)
def test_left_and_right_jacobians_differ_by_the_adjoint(rng, angle):
    x = sixes(rng, angle=angle)
    ride = se3.adjoint(se3.exp(x))
    close(se3.left_jacobian_inverse(x) @ ride, se3.right_jacobian_inverse(x), 1e-11)
    close(se3.right_jacobian(x) @ x, x)


@law
@given(generators, angles)
def test_right_jacobian_is_the_mean_of_the_adjoint_along_the_way(rng, angle):
    x = sixes(rng, angle=angle)
    places, weights = np.polynomial.legendre.leggauss(20)
    along = se3.adjoint(se3.exp(-0.5 * (places + 1.0)[:, None] * x))
    close(se3.right_jacobian(x), np.einsum("u,uij->ij", 0.5 * weights, along))


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.5, SWITCH, 2.0, 3.0])
def test_right_jacobian_is_the_slope_of_exp(angle):
    x = sixes(np.random.default_rng(5), 20, angle=angle)

    def apart(pose, start):
        return se3.log(se3.inverse(start) @ pose)

    slope_test(lambda d: se3.exp(x + d), se3.right_jacobian(x), difference=apart)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.5, SWITCH, 2.0, 3.0])
def test_inverse_jacobians_are_the_slopes_of_log(angle):
    x = sixes(np.random.default_rng(6), 20, angle=angle)
    slope_test(lambda d: se3.log(se3.exp(x) @ se3.exp(d)), se3.right_jacobian_inverse(x))
    slope_test(lambda d: se3.log(se3.exp(d) @ se3.exp(x)), se3.left_jacobian_inverse(x))


def test_the_slope_test_refuses_a_wrong_jacobian():
    x = sixes(np.random.default_rng(7), 20, angle=1.0)
    wrong = se3.right_jacobian_inverse(x)
    wrong[13, 2, 4] += 1e-3
    with pytest.raises(AssertionError, match="element \\(13,\\)"):
        slope_test(lambda d: se3.log(se3.exp(x) @ se3.exp(d)), wrong)


@pytest.mark.parametrize("shape", [(), (3,), (0,), (2, 1, 3)])
def test_every_function_takes_any_leading_shape(shape):
    x = sixes(np.random.default_rng(8), *shape)
    pose = se3.exp(x)
    one_by_one = [x[i] for i in np.ndindex(shape)]
    of_sixes = [se3.exp, se3.hat, se3.ad, se3.right_jacobian]
    of_sixes += [se3.right_jacobian_inverse, se3.left_jacobian_inverse]
    for f in of_sixes:
        tail = f(np.zeros(6)).shape
        expected = np.array([f(v) for v in one_by_one]).reshape(*shape, *tail)
        np.testing.assert_allclose(f(x), expected, rtol=0.0, atol=1e-15)
    for g in (se3.log, se3.inverse, se3.adjoint):
        tail = g(np.eye(4)).shape
        expected = np.array([g(se3.exp(v)) for v in one_by_one]).reshape(*shape, *tail)
        np.testing.assert_allclose(g(pose), expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(("angle", "least"), [(0.03, 0.98), (0.3, 0.85), (0.6, 0.5)])
def test_the_position_covariance_is_that_of_drawn_positions_or_careful(angle, least):
    """Of bodies on an arm of half a metre that turns, where first order is flat across the arc."""
    arm = se3.adjoint(se3.inverse(se3.exp(np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]))))
    root = arm @ np.diag(np.repeat([0.005, angle], 3))
    steps = np.random.default_rng(0).standard_normal((40_000, 6)) @ root.T
    drawn = se3.exp(steps)[:, :3, 3]
    moment = drawn.T @ drawn / len(drawn)
    cov = root @ root.T
    share = np.trace(np.linalg.solve(se3.position_covariance(cov), moment)) / 3.0
    assert least < share < 1.02
    assert angle < 0.1 or np.trace(np.linalg.solve(cov[:3, :3], moment)) / 3.0 > 40.0
