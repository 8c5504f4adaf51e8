"""The process in time: steps, their noise and their bridges are exact and keep their digits."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from scipy.linalg import expm

from draws import generators, law
from glissando.model.priors import matern
from oracles import separable as oracle


def exact_noise(time_scale, step):
    """Q = P∞ − Φ P∞ Φᵀ with sixty digits, where the difference may cancel."""
    with localcontext() as context:
        context.prec = 60
        rate, step = Decimal(3).sqrt() / Decimal(time_scale), Decimal(step)
        a, fade = rate * step, (-rate * step).exp()
        phi = ((1 + a) * fade, step * fade, -rate * a * fade, (1 - a) * fade)
        start = Decimal(1), rate**2
        rows = [
            [start[0] - phi[0] ** 2 * start[0] - phi[1] ** 2 * start[1]],
            [-phi[0] * phi[2] * start[0] - phi[1] * phi[3] * start[1]],
            [start[1] - phi[2] ** 2 * start[0] - phi[3] ** 2 * start[1]],
        ]
        first, corner, last = (float(row[0]) for row in rows)
    return np.array([[first, corner], [corner, last]])


@pytest.mark.parametrize("time_scale", [0.02, 0.8, 30.0])
def test_the_noise_of_a_step_is_what_fading_leaves_to_fill(time_scale):
    steps = time_scale * np.array([0.1, 0.5, 1.0, 3.0])
    phi, start = matern.transition(time_scale, steps), matern.stationary(time_scale)
    expected = start - phi @ start @ phi.swapaxes(1, 2)
    unit = np.sqrt(np.outer(np.diag(start), np.diag(start)))
    found = matern.process_covariance(time_scale, steps)
    np.testing.assert_allclose(found / unit, expected / unit, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("share", 10.0 ** np.arange(-9, 2))
def test_the_noise_of_a_step_keeps_its_digits_however_short_the_step(share):
    found = matern.process_covariance(0.8, np.array(0.8 * share))
    np.testing.assert_allclose(found, exact_noise(0.8, 0.8 * share), rtol=1e-12)


def test_the_noise_of_a_short_step_has_its_limits():
    rate, a = np.sqrt(3.0) / 0.8, 1e-7
    found = matern.process_covariance(0.8, np.array(a / rate))
    limit = np.array([[4 / 3 * a**3, 2 * rate * a**2], [2 * rate * a**2, 4 * rate**2 * a]])
    np.testing.assert_allclose(found, limit, rtol=4 * a)


@law
@given(generators)
def test_two_steps_are_one_long_step(rng):
    scale, (a, b) = rng.uniform(0.1, 10.0), rng.uniform(0.0, 3.0, 2)
    first, then = (matern.transition(scale, scale * step) for step in (a, b))
    whole = matern.transition(scale, scale * (a + b))
    unit = np.diag([1.0, np.sqrt(3.0) / scale])
    np.testing.assert_allclose(
        np.linalg.solve(unit, then @ first @ unit),
        np.linalg.solve(unit, whole @ unit),
        rtol=0.0,
        atol=1e-14,
    )
    noise = then @ matern.process_covariance(scale, scale * a) @ then.T
    noise = noise + matern.process_covariance(scale, scale * b)
    total = matern.process_covariance(scale, scale * (a + b))
    np.testing.assert_allclose(noise, total, rtol=1e-10, atol=1e-15 * unit[1, 1])


@law
@given(generators)
def test_a_step_is_the_exponential_of_its_drift(rng):
    scale = rng.uniform(0.1, 10.0)
    step, rate = np.array(scale * rng.uniform(0.0, 3.0)), np.sqrt(3.0) / scale
    drift = np.array([[0.0, 1.0], [-(rate**2), -2.0 * rate]])
    np.testing.assert_allclose(
        matern.transition(scale, step), expm(step * drift), rtol=1e-10, atol=1e-13
    )


@law
@given(generators)
def test_a_bridge_in_time_is_the_process_conditioned_on_both_ends(rng):
    scale = rng.uniform(0.1, 10.0)
    step = scale * rng.uniform(0.2, 3.0)
    offset = step * rng.uniform(0.1, 0.9)
    times = 0.0, step, offset
    cov = np.block([[oracle.matern(t - t2, scale) for t2 in times] for t in times])
    gain = np.linalg.solve(cov[:4, :4], cov[:4, 4:]).T
    left = cov[4:, 4:] - gain @ cov[:4, 4:]
    unit = np.array([1.0, np.sqrt(3.0) / scale])
    early, late, found = matern.bridge(scale, np.array([step]), np.array([offset]))
    weights = np.concatenate([early[0], late[0]], axis=1)
    tilt = np.tile(unit, 2) / unit[:, None]
    np.testing.assert_allclose(weights * tilt, gain * tilt, rtol=0.0, atol=1e-9)
    tilt = 1.0 / np.outer(unit, unit)
    np.testing.assert_allclose(found[0] * tilt, left * tilt, rtol=1e-6, atol=1e-9)
