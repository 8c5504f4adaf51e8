"""Predicting truth: its score, and the frame and mounts that it is seen in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from glissando import estimate, load_robot, uniform_grid
from glissando.calibration.robot import predictive
from glissando.calibration.robot.predictive import constants_of, predict
from glissando.geometry import se3
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.sensors import PoseReadings, PositionReadings
from glissando.model.state import State
from learn_drawn import readings
from scenes import LENGTH, arc


def posterior_of_the_arc():
    time = np.linspace(0.0, 1.0, 21)
    seen = [
        readings(PoseReadings, f"p{i}", s, time, std=np.full(6, 2e-4), seed=i)
        for i, s in enumerate((0.0, LENGTH / 2, LENGTH))
    ]
    return estimate(load_robot("tdcr466").prior, uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0), seen)


TIMES = np.linspace(0.0, 1.0, 6)


def test_the_score_is_the_gaussian_log_likelihood(monkeypatch):
    monkeypatch.setattr(predictive, "APART", 0.1)
    posterior = posterior_of_the_arc()
    std = np.r_[1e-3, 2e-3, 1e-3, 1e-2, 2e-2, 1e-2]
    truth = [
        readings(PoseReadings, f"t{i}", s, TIMES, std=std, seed=20 + i)
        for i, s in enumerate((0.3, LENGTH))
    ]
    total = 0.0
    for t in truth:
        at = posterior.at(t.arclength, t.time)
        state = State(at.pose, at.strain, at.velocity)
        for residual, by, cov in zip(t.residual(state), t.jacobian(state), at.cov, strict=True):
            total += multivariate_normal.logpdf(residual, cov=by @ cov @ by.T + np.diag(std**2))
    found = predict(posterior, truth, (), free=False)
    assert found.samples == 2 * 6 * 6
    assert found.value == pytest.approx(total / found.samples, rel=1e-9)
    none = [t.select(slice(0, 0)) for t in truth]
    assert predict(posterior, [*truth, *none], (), free=False).value == found.value


def test_truth_that_rests_counts_once_and_all_of_it_counts_while_any_moves():
    time = np.linspace(0.0, 9.9, 100)
    rests, moves = np.repeat(0.0, 100), np.linspace(0.0, 4.0, 100)
    tip = {"arclength": np.full(100, LENGTH), "cov": np.full(6, 1e-6)}
    still, swung = (
        PoseReadings(time=time, values=arc(LENGTH, when), name="tip", **tip)
        for when in (rests, moves)
    )
    half = replace(swung, values=np.concatenate([still.values[:50], swung.values[50:]]))
    base = replace(swung, arclength=np.zeros(100), values=arc(0.0, moves))
    none = still.select(slice(0, 0))
    found = [
        [len(stream) for stream in predictive.informative(truth)]
        for truth in ([still], [swung], [half], [base], [base, none, half], [])
    ]
    assert found == [[1], [20], [11], [1], [11, 0, 11], []]
    place = PositionReadings(
        time=time, values=still.values[:, :3, 3], name="p", **tip | {"cov": 1e-6}
    )
    assert len(predictive.informative([place])[0]) == 20  # places alone cannot be compared


def test_the_frame_of_the_truth_and_the_mounts_of_its_bodies_are_found():
    posterior, small = posterior_of_the_arc(), np.full(6, 3e-4)
    true = [
        readings(PoseReadings, name, s, TIMES, std=small, seed=i)
        for i, (name, s) in enumerate((("a", LENGTH / 2), ("b", LENGTH)))
    ]
    frame = np.r_[0.01, -0.005, 0.008, 0.02, -0.04, 0.03]
    mounts = [np.r_[-0.004, 0.006, 0.003, 0.05, 0.03, -0.1], np.r_[0.003, 0, 0.005, 0, 0.08, 0.1]]
    off = [
        replace(t, values=se3.exp(-frame) @ t.values @ se3.exp(mount))
        for t, mount in zip(true, mounts, strict=True)
    ]
    names = constants_of(off)
    assert [c.name for c in names] == ["truth frame", "a mount", "b mount"]
    best = predict(posterior, true, (), free=False)
    raw = predict(posterior, off, names, free=False)
    found = predict(posterior, off, names, free=True)
    assert raw.value < best.value - 10.0
    assert found.value > best.value - 0.05
    # A frame and mounts are told apart by motion alone; what they do together is found exactly.
    turned, *mounted = (se3.exp(c.value) for c in found.constants)
    for t, was, mount in zip(off, true, mounted, strict=True):
        apart = se3.log(se3.inverse(was.values) @ turned @ t.values @ se3.inverse(mount))
        assert np.abs(apart[:, :3]).max() < 2e-3
        assert np.abs(apart[:, 3:]).max() < 1e-2
    for i, each in enumerate([frame, *mounts]):
        alone = [
            replace(t, values=se3.exp(-each) @ t.values if i == 0 else t.values @ se3.exp(each))
            for t in (true if i == 0 else true[i - 1 : i])
        ]
        (one,) = predict(posterior, alone, names[i : i + 1], free=True).constants
        np.testing.assert_allclose(one.value[:3], each[:3], atol=1e-3)
        np.testing.assert_allclose(one.value[3:], each[3:], atol=5e-3)
    assert predict(posterior, off, found.constants, free=False).value == found.value


def test_truth_that_is_known_to_be_late_is_asked_for_when_it_was_made():
    posterior, late = posterior_of_the_arc(), 0.3
    truth = readings(PoseReadings, "a", LENGTH, TIMES[:4], std=np.full(6, 3e-4), seed=1)
    stamped = replace(truth, time=truth.time + late)
    delay = SensorParameter("late", "time_offset", ("a",), np.array([late]), np.zeros(1))
    found = predict(posterior, [stamped], [delay], free=False)
    assert found.value == pytest.approx(predict(posterior, [truth], (), free=False).value)
    assert found.value > predict(posterior, [stamped], (), free=False).value + 2.0
    assert found.constants == (delay,)
    early = replace(truth, time=truth.time + 0.5 * late)  # its first rows were made before the grid
    assert predict(posterior, [early], [delay], free=False).samples < found.samples
