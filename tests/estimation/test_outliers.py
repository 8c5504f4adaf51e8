"""Outliers in a batch: refused and named, whatever their size, and no sound reading with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators, law
from glissando import PoseReadings, estimate, load_recording, load_robot
from glissando.errors import SensorError
from glissando.estimation.outliers import spikes
from glissando.evaluation.metrics import errors_against, pool
from glissando.evaluation.run import chosen_streams
from glissando.geometry import se3
from glissando.model.noise import Huber
from scenes import sliding_scene

SPACETIME = Path(__file__).parents[3] / "shared/data/spacetime"
PRIOR, GRID, _ = sliding_scene()


def thrown(rng, stream, row, least=0.0):
    """The stream with one reading thrown off, by 0.1 m to 1 km or by 100 rad/s and more."""
    values = stream.values.copy()
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    if values.shape[1:] == (4, 4):
        values[row, :3, 3] += 10.0 ** rng.uniform(-1.0 + least, 3.0) * way
    else:
        values[row] += 10.0 ** rng.uniform(2.0, 5.0) * way
    return replace(stream, values=values)


@pytest.mark.slow
@settings(law, max_examples=12)
@given(generators)
def test_outliers_of_any_size_are_named_and_change_nothing_else(rng):
    _, _, readings = sliding_scene(int(rng.integers(1000)))
    bad = {}
    for k in rng.permutation(3)[: rng.integers(1, 4)]:
        row = int(rng.integers(len(readings[k])))
        readings[k] = thrown(rng, readings[k], row)
        bad[readings[k].label] = [row]
    found = estimate(PRIOR, GRID, readings)
    assert found.solve.converged
    assert found.solve.refused == bad
    kept = [r.select(~np.isin(np.arange(len(r)), bad.get(r.label, []))) for r in readings]
    without = estimate(PRIOR, GRID, kept, gate=None)
    miss = found.state.difference(without.state).reshape(len(GRID.time), -1)
    std = np.sqrt(np.einsum("kii->ki", without.marginals.cov))
    assert np.abs(miss / std).max() < 0.1


@pytest.mark.parametrize("seed", range(10))
def test_of_sound_readings_none_is_refused(seed):
    readings = sliding_scene(seed)[2]
    found, all_of_them = (estimate(PRIOR, GRID, readings, gate=gate) for gate in (1e-9, None))
    assert found.solve.refused == {}
    np.testing.assert_array_equal(found.state.pose, all_of_them.state.pose)


def test_a_stream_that_is_wrong_as_a_whole_has_no_outliers():
    base, coil, gyro = sliding_scene()[2]
    off = replace(coil, values=se3.exp(np.array([0.05, 0, 0, 0, 0.1, 0])) @ coil.values)
    assert estimate(PRIOR, GRID, [base, off, gyro]).solve.refused == {}


def test_a_stream_with_a_robust_loss_keeps_its_readings():
    base, coil, gyro = sliding_scene()[2]
    wrong = replace(thrown(np.random.default_rng(1), gyro, 5), loss=Huber())
    assert estimate(PRIOR, GRID, [base, coil, wrong]).solve.refused == {}


@pytest.mark.slow
def test_a_coil_in_millimetres_ends_in_a_sentence_or_a_warning_not_in_a_traceback():
    base, coil, gyro = sliding_scene()[2]
    values = coil.values.copy()
    values[:, :3, 3] *= 1e6
    with pytest.raises(SensorError, match=r"coil row \d+ at .* m from the base. Check units"):
        estimate(PRIOR, GRID, [base, replace(coil, values=values), gyro])


@settings(law, max_examples=20)
@given(generators)
def test_only_what_leaves_its_neighbours_behind_is_a_spike(rng):
    coil = sliding_scene(int(rng.integers(1000)))[2][1]
    assert not spikes(coil).any()
    row = int(rng.integers(len(coil)))
    wrong = thrown(rng, coil, row, least=0.5)
    shuffled = rng.permutation(len(coil))
    assert np.flatnonzero(spikes(wrong)).tolist() == [row]
    assert shuffled[spikes(wrong.select(shuffled))].tolist() == [row]


@law
@given(generators, st.sampled_from(["moved", "turned"]))
def test_spikes_show_in_a_fast_motion(rng, how):
    """What is wrong is less than the tracker goes and turns between a few readings."""
    time = np.sort(rng.uniform(0.0, 3.0, 120))
    sway = rng.uniform(-1.0, 1.0, (2, 6)) * [0.15, 0.15, 0.15, 0.6, 0.6, 0.6]
    motion = np.sin(4.0 * time)[:, None] * sway[0] + np.cos(3.0 * time)[:, None] * sway[1]
    std = np.repeat([1e-3, 1e-2], 3)
    values = se3.exp(motion) @ se3.exp(std * rng.standard_normal((time.size, 6)))
    tip = PoseReadings(time=time, arclength=np.full(time.size, 0.5), values=values, cov=std**2)
    assert not spikes(tip).any()
    rows = np.arange(5, 115, 20) + rng.integers(0, 8)
    off, way = np.zeros((rows.size, 6)), rng.standard_normal((rows.size, 3))
    way *= {"moved": 0.2, "turned": 1.5}[how] / np.linalg.norm(way, axis=1, keepdims=True)
    off[:, slice(0, 3) if how == "moved" else slice(3, 6)] = way
    values[rows] = values[rows] @ se3.exp(off)
    found = np.flatnonzero(spikes(tip.changed(values=values)))
    assert set(found) <= set(rows)
    assert found.size >= rows.size - 1


@pytest.mark.slow
@pytest.mark.skipif(not SPACETIME.exists(), reason="the public recordings are not here")
@pytest.mark.parametrize("name", ["slow_free_space", "fast_contact"])
def test_on_public_recordings_outliers_cost_nothing(name):
    recording, robot = load_recording(SPACETIME / name), load_robot("tdcr466")
    window, rng = (20.0, 23.0), np.random.default_rng(7)
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)

    def rmse(streams):
        found = estimate(robot.prior, robot.grid(*window), streams)
        assert found.solve.converged
        errors = pool([errors_against(found, t) for t in truth])
        return errors.summary()["position_rmse"], found.solve.refused

    clean, none = rmse(readings)
    assert none == {}
    for _ in range(5):
        k = int(rng.integers(len(readings)))
        row = int(rng.integers(len(readings[k])))
        streams = [*readings[:k], thrown(rng, readings[k], row, least=0.3), *readings[k + 1 :]]
        found, refused = rmse(streams)
        assert refused == {readings[k].label: [row]}
        assert abs(found - clean) < 2e-4
