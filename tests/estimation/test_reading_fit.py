"""How readings agree with an estimate: with drifts, delays and unsure places counted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from draws import generators, law
from glissando import estimate, load_robot
from glissando.estimation.reading_fit import fit_of
from glissando.evaluation.metrics import innovations
from glissando.evaluation.prior_predictive import PriorPredictive, session_layout
from glissando.geometry import se3
from glissando.model.sensors.parameters import SensorParameter
from scenes import sliding_scene

ROBOT = Path(__file__).parents[2] / "benchmarks" / "sbc.toml"


def unsure(rng):
    """A sliding scene in which sensors drift, lag and slip, and are said to."""
    prior, grid, (base, coil, gyro) = sliding_scene(int(rng.integers(1000)))
    drift = 3e-3 * np.cumsum(rng.standard_normal((len(coil), 3)), axis=0)
    turn = np.zeros((len(coil), 6))
    turn[:, :3] = drift
    parameters = [
        SensorParameter("drift", "mount", ("coil",), np.zeros(6), [0.01] * 3 + [0.0] * 3, 0.3),
        SensorParameter("zero", "arclength_offset", ("coil",), [0.0], [2e-3]),
        SensorParameter("late", "time_offset", ("gyro",), [0.0], [5e-3]),
        SensorParameter("bias", "bias", ("gyro",), np.zeros(3), [0.02] * 3, 2.0),
    ]
    moved = replace(coil, values=coil.values @ se3.exp(turn), arclength_std=1e-3)
    return prior, grid, [base, moved, gyro], parameters


@pytest.mark.slow
@settings(law, max_examples=8)
@given(generators)
def test_an_innovation_is_the_distance_from_what_all_others_predict(rng):
    prior, grid, readings, parameters = unsure(rng)
    given_them = {"sensor_parameters": parameters, "gate": None}
    every = estimate(prior, grid, readings, **given_them)
    k = int(rng.integers(3))
    m = int(rng.integers(2, len(readings[k]) - 2))
    rest = [r.select(np.arange(len(r)) != m) if j == k else r for j, r in enumerate(readings)]
    start = {"initial": every.state, "initial_parameters": every.sensor_parameters}
    others = estimate(prior, grid, rest, **given_them, **start)
    predicted = fit_of(others, readings[k].select([m])).squared(False, 1.0)
    np.testing.assert_allclose(innovations(every, readings[k])[m], predicted[0], rtol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_no_reading_with_a_delay_explains_more_than_it_says(seed):
    """Delays spread the motions of a robot by many times the noise of its readings."""
    late = tuple(SensorParameter(s, "time_offset", (s,), [0.0], [0.02]) for s in ("gyro", "tip"))
    robot = replace(load_robot(ROBOT), sensor_parameters=late, time_rate=15.0)
    grid, layout = session_layout(robot)
    read = PriorPredictive(robot, grid, layout).draw(np.random.default_rng(seed)).readings
    posterior = estimate(robot.prior, grid, read, sensor_parameters=robot.sensor_parameters)
    for stream in read:
        fit = fit_of(posterior, stream)
        used = fit.weight[:, None] * np.linalg.eigvalsh(fit.explained)
        assert used.max() < 1.0 + 1e-6, stream.label
