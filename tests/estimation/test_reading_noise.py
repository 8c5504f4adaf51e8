"""A sensor that does not know where it was is judged as the estimator weighs it (equation 16)."""

from dataclasses import replace

import numpy as np
import pytest

from glissando import PoseReadings, PositionReadings, SeparablePrior, estimate, load_robot
from glissando.evaluation.metrics import errors_against, innovations, prediction_scores
from glissando.geometry import se3
from glissando.model.grid import Grid

LENGTH, STD, NOISE = 0.3, 5e-3, 1e-4
TIME = np.arange(0.01, 2.0, 0.05)
ROBOT = load_robot("tdcr466-segments")
GRID = Grid(np.linspace(0.0, LENGTH, 4), np.arange(0.0, 2.01, 0.1))


def where(place, time):
    """Where an arc of changing curvature is."""
    bend = np.zeros((time.size, 6))
    bend[:, 2], bend[:, 4] = 1.0, 4.0 * np.sin(2.0 * time)
    return se3.exp(place[:, None] * bend)[:, :3, 3]


def positions(place, rng, stated=None, std=0.0):
    values = where(place, TIME) + NOISE * rng.standard_normal((TIME.size, 3))
    at = place if stated is None else stated
    name = f"at {place[0]:.3g}"
    return PositionReadings(
        time=TIME, arclength=at, values=values, cov=NOISE**2, name=name, arclength_std=std
    )


def test_innovations_and_predictions_know_of_an_unsure_arclength():
    rng = np.random.default_rng(4)
    base = ROBOT.prior.base
    prior = SeparablePrior(
        np.array([1e-6, 1e-6, 1e-6, 5.0, 5.0, 0.1]), 0.5,
        replace(base, strain=np.array([1e-8, 1e-8, 1e-8, 30.0, 30.0, 0.1])),
    )  # fmt: skip
    others = [positions(np.full(TIME.size, s), rng) for s in (0.15, 0.3)]
    stated = 0.15 + 0.12 * np.sin(3.0 * TIME)
    coil = positions(stated + STD * rng.standard_normal(TIME.size), rng, stated, STD)
    found = estimate(prior, GRID, [*others, coil], gate=None)
    assert 0.2 < innovations(found, coil).mean() / 3.0 < 2.0
    alone = estimate(prior, GRID, others, gate=None)
    assert 0.2 < np.mean(prediction_scores(alone, coil) ** 2) / 3.0 < 2.0
    assert not any(estimate(prior, GRID, [*others, coil]).solve.refused.values())


def test_truth_may_have_a_mount_for_each_reading():
    rng = np.random.default_rng(1)
    found = estimate(ROBOT.prior, ROBOT.grid(0.0, 1.0), [])
    mounts = se3.exp(0.02 * rng.standard_normal((3, 6)))
    time, place = np.array([0.1, 0.4, 0.8]), np.full(3, ROBOT.length)
    values = found.at(place, time).pose @ mounts @ se3.exp(0.01 * rng.standard_normal((3, 6)))
    truth = PoseReadings(
        time=time, arclength=place, values=values, cov=np.full(6, 1e-6), mount=mounts
    )
    every = errors_against(found, truth)
    for k in range(3):
        one = errors_against(found, truth.select(np.array([k])).changed(mount=mounts[k]))
        for name in ("position", "rotation", "nees_position", "nees_rotation"):
            assert getattr(one, name)[0] == pytest.approx(getattr(every, name)[k], rel=1e-9)
