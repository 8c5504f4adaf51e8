"""Mistakes in a script are answered with a sentence, too."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from glissando import FbgReadings, GlissandoError, GyroReadings, Huber, Readings, estimate
from glissando.errors import OutsideGridError, SensorError
from glissando.evaluation.metrics import errors_against
from glissando.io.netcdf import save_posterior
from scenes import sliding_scene

SCENE = sliding_scene()
ROWS = 5


def placed(kind, **more):
    """A sensor of one row a reading at the tip."""
    at = {"time": np.linspace(0, 1, ROWS), "arclength": np.full(ROWS, 0.466)}
    return kind(**at, values=np.zeros(ROWS), cov=1.0, **more)


@dataclass(frozen=True, kw_only=True)
class Flat(Readings):
    rows = 1

    def residual(self, at):
        return at.pose[:, 2, 3:] - self.values[:, None]


class NoColumn(Flat):
    def residual(self, at):
        return at.pose[:, 2, 3]


class Nothing(Flat):
    def residual(self, at):
        """Forget to return it."""


class FlatSlope(Flat):
    def jacobian(self, at):
        return np.zeros((len(self), 18))


class Blind(Flat):
    def residual(self, at):
        return np.full((len(self), 1), np.nan)


@dataclass(frozen=True, kw_only=True)
class Ray(Flat):
    """Distance along a direction of its own for each reading."""

    direction: np.ndarray = field(default_factory=lambda: np.zeros((ROWS, 3)))
    per_reading = ("direction",)

    def residual(self, at):
        along = np.sum(self.direction * at.pose[:, :3, 3], axis=1)
        return (along - self.values)[:, None]


@pytest.mark.parametrize(
    ("sensor", "sentence"),
    [
        (NoColumn, r"residual\(at\) returns shape \(\d+,\); return"),
        (Nothing, r"residual\(at\) returns shape \(\); return"),
        (FlatSlope, r"jacobian\(at\) returns shape \(\d+, 18\); return"),
        (Blind, "the residual of row 0 is not finite"),
    ],
)
def test_a_sensor_of_the_wrong_shape_is_named(sensor, sentence):
    prior, grid, readings = SCENE
    with pytest.raises(SensorError, match=sentence):
        estimate(prior, grid, [*readings, placed(sensor)])


def test_fields_with_a_row_a_reading_are_selected_with_it():
    prior, grid, readings = SCENE
    ray = placed(Ray, direction=np.arange(3.0 * ROWS).reshape(ROWS, 3))
    assert ray.select(slice(1, 3)).direction.tolist() == [[3, 4, 5], [6, 7, 8]]
    assert estimate(prior, grid, [*readings, ray]).solve.converged


def test_a_start_on_another_grid_is_refused():
    prior, grid, readings = SCENE
    other = prior.rest_state(sliding_scene(nodes=3)[1])
    with pytest.raises(OutsideGridError, match=r"has \(11, 3\) nodes and the grid \(11, 4\)"):
        estimate(prior, grid, readings, initial=other)


def test_readings_not_in_a_list_are_refused():
    prior, grid, readings = SCENE
    with pytest.raises(SensorError, match="go in a list"):
        estimate(prior, grid, readings[0])


def test_a_gyro_cannot_be_truth():
    prior, grid, readings = SCENE
    assert isinstance(readings[2], GyroReadings)
    with pytest.raises(SensorError, match="gyro: a GyroReadings cannot be truth"):
        errors_against(estimate(prior, grid, readings), readings[2])


def test_a_posterior_that_cannot_be_written_is_one_sentence(tmp_path):
    posterior = estimate(*SCENE)
    with pytest.raises(GlissandoError, match="cannot be written"):
        save_posterior(posterior, tmp_path)


def test_a_loss_without_a_threshold_is_refused():
    with pytest.raises(SensorError, match="give one above zero"):
        Huber(-1.0)


def test_cores_that_are_no_list_are_refused():
    with pytest.raises(SensorError, match="must be lists of one length"):
        placed(FbgReadings, core_radius=1e-3, core_angle=0.0)


def test_no_samples_are_an_empty_state():
    posterior = estimate(*SCENE)
    assert posterior.sample(np.random.default_rng(0), 0).pose.shape == (0, 11, 4, 4, 4)
