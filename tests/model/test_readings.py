"""Readings as data: what is refused, what is kept, and how they are weighed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, spd
from glissando.errors import SensorError
from glissando.estimation.batch import estimate
from glissando.model.grid import Grid
from glissando.model.noise import GemanMcClure, Huber, covariance_matrix, sqrt_information
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.sensors.accelerometer import AccelerometerReadings
from glissando.model.sensors.sensors import (
    CoilReadings,
    FbgReadings,
    GyroReadings,
    PoseReadings,
    PositionReadings,
    Readings,
    StrainReadings,
    TendonReadings,
)

NAN = np.array([0.0, np.nan, 0.0])
ZERO, POINTS = np.zeros(3), np.zeros((3, 3))
MISTAKES = {
    "time of row 1 is nan; drop that row": {"time": NAN},
    "arclength of row 1 is nan; drop that row": {"arclength": NAN},
    "values of row 2 is .*inf.*; drop that row": {"values": np.diag([0.0, 0.0, np.inf])},
    "must share their first length; give one of each a row": {"time": np.zeros(2)},
    r"arclength \(2,\) and .* must share their first length": {"arclength": np.zeros(2)},
    "give a variance, 3 variances, or a 3×3 matrix": {"cov": np.ones(5)},
    r"give a variance, 3 variances, .* \(one, or one a reading\)": {"cov": np.ones((3, 2))},
    "not positive definite; give every row a variance above zero": {"cov": 0.0},
    "probe: covariance is not symmetric": {"cov": np.eye(3) + np.eye(3, k=1), "name": "probe"},
    "PositionReadings: covariance is not finite": {"cov": [1.0, np.nan, 1.0]},
    "covariance is not finite; give every row a finite variance": {"cov": np.inf},
    "covariance is 'much'; give numbers": {"cov": "much"},
}


def positions(**changes):
    return PositionReadings(**{**{"time": ZERO, "arclength": ZERO, "values": POINTS}, **changes})


@pytest.mark.parametrize("sentence", MISTAKES)
def test_a_mistake_is_answered_with_a_sentence(sentence):
    with pytest.raises(SensorError, match=sentence):
        positions(**{"cov": 1.0, **MISTAKES[sentence]})


FBG = {"core_radius": [1e-3], "core_angle": [0.0], "values": np.zeros((3, 1))}
TENDON = {"radius": [1e-3], "angle": [0.0], "end": [0.2], "values": np.zeros((3, 1))}
TURNED = np.diag([1.0, -1.0, -1.0, 1.0])
UNHEARD = {
    "of kind fbg have no mount": (FbgReadings, {**FBG, "mount": TURNED}),
    "of kind strain have no mount": (StrainReadings, {"values": np.zeros((3, 6)), "mount": TURNED}),
    "uncertain arclength of readings of kind tendon": (
        TendonReadings,
        {**TENDON, "arclength_std": 0.1},
    ),
    "uncertain arclength of readings of kind accelerometer": (
        AccelerometerReadings,
        {"values": POINTS, "arclength_std": 0.1},
    ),
    r"core_radius is \[35.0\]; give metres": (FbgReadings, {**FBG, "core_radius": [35.0]}),
    r"core_angle is \[120.0\]; give radians": (FbgReadings, {**FBG, "core_angle": [120.0]}),
    r"core_radius is \['wide'\]; give numbers": (FbgReadings, {**FBG, "core_radius": ["wide"]}),
    r"end is \[-0.1\]; give finite numbers above": (TendonReadings, {**TENDON, "end": [-0.1]}),
    r"slack is \[nan\]; give finite": (TendonReadings, {**TENDON, "slack": [np.nan]}),
    r"compliance is \[-1.0\]": (TendonReadings, {**TENDON, "compliance": [-1.0]}),
    "radius is 'a'; give numbers": (TendonReadings, {**TENDON, "radius": "a"}),
    "loss is 'huber'; give Huber": (PositionReadings, {"values": POINTS, "loss": "huber"}),
    "loss is <class .*Huber'>; give Huber": (PositionReadings, {"values": POINTS, "loss": Huber}),
    r"time is \['a'\]; give numbers": (PositionReadings, {"values": POINTS, "time": ["a"]}),
    "time is float32, which rounds 1.7e.09 s to 1.3e.02 s; give float64": (
        PositionReadings,
        {"values": POINTS, "time": np.full(3, 1.7e9, dtype=np.float32)},
    ),
    "arclength_std is 'a'": (PositionReadings, {"values": POINTS, "arclength_std": "a"}),
    "slide_speed is 'a'": (PositionReadings, {"values": POINTS, "slide_speed": "a"}),
}


@pytest.mark.parametrize("sentence", UNHEARD)
def test_what_would_change_nothing_or_cannot_be_is_one_sentence(sentence):
    sensor, given = UNHEARD[sentence]
    with pytest.raises(SensorError, match=sentence):
        sensor(**{"time": ZERO, "arclength": ZERO, "cov": 1e-4, **given})


@pytest.mark.parametrize("threshold", ["3", None, 0.0, np.nan])
def test_a_loss_has_a_threshold_above_zero(threshold):
    with pytest.raises(SensorError, match="The threshold of a loss"):
        Huber(threshold)


TREE = {"core_radius": np.array([0.0, 1e-3]), "core_angle": np.zeros(2)}
MISSHAPEN = {
    "one coordinate a position": (PositionReadings, np.zeros((3, 1)), {}),
    "one rate a gyro": (GyroReadings, np.zeros((3, 1)), {}),
    "poses of three by three": (PoseReadings, np.tile(np.eye(3), (3, 1, 1)), {}),
    "poses that are all zero": (CoilReadings, np.zeros((3, 4, 4)), {}),
    "one strain for two cores": (FbgReadings, np.zeros((3, 1)), TREE),
    "one angle for two cores": (FbgReadings, np.zeros((3, 2)), {**TREE, "core_angle": ZERO[:1]}),
    "two covariances for three": (PositionReadings, POINTS, {"cov": np.tile(np.eye(3), (2, 1, 1))}),
    "a mount of three by three": (PositionReadings, POINTS, {"mount": np.eye(3)}),
}


@pytest.mark.parametrize("mistake", MISSHAPEN)
def test_arrays_that_numpy_would_stretch_to_fit_are_refused(mistake):
    sensor, values, more = MISSHAPEN[mistake]
    with pytest.raises(SensorError):
        sensor(**{"time": ZERO, "arclength": ZERO, "values": values, "cov": 1e-4, **more})


class DeafReadings(Readings):
    """A sensor that hears nothing of the state, and says so."""

    rows = 1

    def residual(self, at):
        """The reading itself."""
        return self.values[:, None]

    def jacobian(self, at):
        """Of nothing."""
        return np.zeros((len(self), 1, 18))


def test_a_sensor_that_hears_nothing_changes_nothing():
    stiff = np.full(6, 1e-3)
    prior = WhiteNoisePrior(stiff, stiff, stiff, stiff, BaseDensity(stiff, stiff, stiff))
    grid = Grid([0.0, 0.1], [0.0, 1.0])
    deaf = DeafReadings(time=ZERO, arclength=ZERO, values=ZERO, cov=1.0)
    with_it, without = (estimate(prior, grid, readings) for readings in ([deaf], []))
    np.testing.assert_array_equal(with_it.state.pose, without.state.pose)
    np.testing.assert_array_equal(with_it.marginals.cov, without.marginals.cov)


def coloured(count):
    """Readings whose every row, place and covariance differs."""
    rows = np.arange(count, dtype=float)
    values = rows[:, None] + np.array([0.1, 0.2, 0.3])
    cov = (1.0 + rows)[:, None, None] * np.eye(3)
    return positions(time=0.1 * rows, arclength=0.01 * rows, values=values, cov=cov, name="paint")


@pytest.mark.parametrize(
    "rows", [slice(1, 7, 2), np.array([1, 3, 5]), np.isin(np.arange(8), [1, 3, 5])]
)
def test_select_takes_the_same_rows_of_everything(rows):
    some = coloured(8).select(rows)
    assert len(some) == 3
    assert some.label == "paint"
    np.testing.assert_allclose(some.time, [0.1, 0.3, 0.5])
    np.testing.assert_allclose(some.arclength, [0.01, 0.03, 0.05])
    np.testing.assert_allclose(some.values[:, 0], [1.1, 3.1, 5.1])
    np.testing.assert_array_equal(some.cov[:, 0, 0], [2.0, 4.0, 6.0])


def test_select_keeps_what_all_rows_share():
    mount = np.diag([1.0, -1.0, -1.0, 1.0])
    places = PositionReadings(
        time=ZERO, arclength=ZERO, values=np.zeros((3, 3)), cov=1e-12, mount=mount,
        loss=Huber(2.0), name="marker",
    )  # fmt: skip
    one = places.select(np.array([2]))
    assert (one.loss, one.name, one.row_count) == (Huber(2.0), "marker", 3)
    np.testing.assert_array_equal(one.mount, mount)
    np.testing.assert_array_equal(one.cov, 1e-12 * np.eye(3))


def test_no_rows_at_all_is_a_choice_like_any_other():
    none = coloured(4).select(np.zeros(4, dtype=bool))
    assert len(none) == 0
    assert none.values.shape == (0, 3)


def test_inside_keeps_the_ends_and_drops_what_lies_beyond_either():
    grid = Grid([0.0, 0.02, 0.05], [0.2, 0.4])
    kept = coloured(8).inside(grid)  # times 0.0 to 0.7, arclengths 0.00 to 0.07
    np.testing.assert_allclose(kept.time, [0.2, 0.3, 0.4])
    grid.require(kept.arclength, kept.time, kept.label)


@law
@given(generators, st.integers(2, 6))
def test_a_covariance_that_rounding_made_uneven_is_one(rng, rows):
    turn = np.linalg.qr(rng.standard_normal((rows, rows)))[0]
    full = turn @ np.diag(10.0 ** rng.uniform(-8, -2, rows)) @ turn.T
    full[0, 1] += 1e-11 * np.sqrt(full[0, 0] * full[1, 1])
    found = covariance_matrix(full, rows, "it")
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_allclose(found, full, atol=1e-11 * full.max())
    full[0, 1] += 0.01 * np.sqrt(full[0, 0] * full[1, 1])
    with pytest.raises(SensorError, match="not symmetric"):
        covariance_matrix(full, rows, "it")


@law
@given(generators, st.integers(1, 5))
def test_a_covariance_may_be_a_number_a_list_or_a_matrix(rng, rows):
    variances = rng.uniform(0.1, 2.0, rows)
    full = spd(rng, size=rows)
    same = np.testing.assert_array_equal
    same(covariance_matrix(variances[0], rows, "it"), variances[0] * np.eye(rows))
    same(covariance_matrix(list(variances), rows, "it"), np.diag(variances))
    same(covariance_matrix(full, rows, "it"), full)
    same(covariance_matrix(full[None], rows, "it"), full[None])


@law
@given(generators, st.integers(1, 6))
def test_the_root_of_information_makes_noise_white(rng, size):
    cov = spd(rng, 4, size=size)
    root = sqrt_information(cov)
    white = root @ cov @ np.swapaxes(root, -1, -2)
    np.testing.assert_allclose(white, np.broadcast_to(np.eye(size), white.shape), atol=1e-9)


@pytest.mark.parametrize("loss", [Huber(2.0), GemanMcClure(2.0)], ids=lambda x: type(x).__name__)
def test_a_losss_weight_is_its_slope_over_the_norm(loss):
    norm = np.linspace(0.01, 12.0, 500)
    slope = (loss.cost(norm + 1e-6) - loss.cost(norm - 1e-6)) / 2e-6
    np.testing.assert_allclose(loss.weight(norm) * norm, slope, atol=1e-6)
    assert loss.weight(np.zeros(1)) == 1.0
    assert np.all(np.diff(loss.weight(norm)) <= 0.0)
    np.testing.assert_allclose(loss.cost(np.array([1e-3])), 0.5e-6, rtol=1e-5)
