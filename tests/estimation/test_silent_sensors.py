"""What is known of a sensor in silence, and where a window begins anew."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from glissando import PositionReadings, load_robot
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry import se3
from glissando.model.sensors.parameters import SensorParameter
from tip_coil import coil, tip

STEP = 1.0 / 30.0


def test_what_was_learned_of_a_sensor_outlives_the_silence():
    robot = load_robot("tdcr466")
    frame = SensorParameter("frame", "frame", ("coil",), np.zeros(6), np.full(6, 0.02))
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, sensor_parameters=[frame])
    rng, shift = np.random.default_rng(4), se3.exp(np.array([5e-3, -4e-3, 3e-3, 0.0, 0.01, 0.0]))
    pose = tip(robot.length, 1.0, 0.0)
    for time in STEP * np.arange(30):
        for name, seen in (("tip", pose), ("coil", se3.inverse(shift) @ pose)):
            smoother.add(replace(coil(rng, time, seen, robot.length), name=name))
        smoother.advance(time)
    value, cov = smoother.posterior().parameter("frame")
    smoother.advance(50.0)
    assert smoother.restarts == 1
    after, cov_after = smoother.posterior().parameter("frame")
    np.testing.assert_allclose(after[-1], value[-1], rtol=0.05, atol=1e-4)
    assert np.all(np.diagonal(cov_after[-1]) >= 0.99 * np.diagonal(cov[-1]))
    assert np.all(np.diagonal(cov_after[-1]) <= 1.3 * np.diagonal(cov[-1]) + 1e-6)


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_sensor_holds_the_shape_while_the_tip_is_silent(every):
    """A window that began anew at rest would throw away what it reads."""
    robot, rng = load_robot("tdcr466"), np.random.default_rng(every)
    wide = replace(robot.prior, psd_strain_arclength=30.0 * robot.prior.psd_strain_arclength)
    smoother = FixedLagSmoother(wide, robot.arclength_nodes)
    middle, off, spread = robot.length / 4, [], []
    for k in range(135):
        time = STEP * k
        curvature = (1.0 + 0.2 * np.sin(time)) / robot.length
        if not 2.0 < time < 4.5:
            smoother.add(coil(rng, time, tip(robot.length, curvature, 0.0), robot.length))
        true = tip(middle, curvature, 0.0)[:3, 3]
        if k % every == 0:
            seen = (true + 5e-4 * rng.standard_normal(3))[None]
            smoother.add(PositionReadings(time=[time], arclength=middle, values=seen, cov=2.5e-7))
        smoother.advance(time)
        if time > 2.5:
            at = smoother.at(middle, time)
            off.append(np.linalg.norm(at.position - true))
            spread.append(at.std_position)
    assert smoother.restarts == 0
    assert max(off) < 5e-3
    assert max(spread) < 0.05  # and 0.096 at rest


def drifting_bias(seed, pause, memory=0.3, std=0.02):
    """Squared errors of a marker's drifting bias, in their covariance, after a pause."""
    robot, rng = load_robot("tdcr466"), np.random.default_rng(seed)
    known = SensorParameter("bias", "bias", ("marker",), np.zeros(3), np.full(3, std), memory)
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, sensor_parameters=[known])
    before, bias, out = 0.0, std * rng.standard_normal(3), []
    times = np.r_[0.1:1.11:0.05, 1.1 + pause : 1.26 + pause : 0.05]
    for k, time in enumerate(times):
        if k in (0, 21):
            pose = tip(robot.length, *rng.normal(0.0, [6.0, 3.0]))
        fade = np.exp((before - time) / memory)
        bias = fade * bias + std * np.sqrt(1.0 - fade**2) * rng.standard_normal(3)
        before = time
        seen = (bias + 5e-4 * rng.standard_normal(3))[None]
        smoother.add(coil(rng, time, pose, robot.length))
        smoother.add(
            PositionReadings(time=[time], arclength=[0.0], values=seen, cov=2.5e-7, name="marker")
        )
        smoother.advance(time)
        if k >= 21:
            value, cov = smoother.posterior().parameter("bias")
            off = value[-1] - bias
            out.append(off @ np.linalg.solve(cov[-1], off))
    return smoother.restarts, out


@pytest.mark.slow
@pytest.mark.parametrize("pause", [0.2, 0.3])
def test_a_drifting_parameter_is_as_sure_as_it_is_where_a_window_begins_anew(pause):
    restarts, squared = zip(*(drifting_bias(seed, pause) for seed in range(24)), strict=True)
    assert sum(restarts) > 5
    assert np.sum(squared, axis=0)[0] < chi2.ppf(1.0 - 1e-6, 3 * 24)  # the base is better known
