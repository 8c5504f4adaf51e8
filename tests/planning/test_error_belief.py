"""What is known of a model error between the corrections of commands."""

import numpy as np
import pytest

from glissando.planning.scene.error_belief import KnownError, predict_covariance
from glissando.planning.scene.sampled_risk import _sampled_errors


@pytest.mark.parametrize("time_scale", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("weight", [0.0, 0.7, 5.0])
def test_between_corrections_an_error_is_as_unknown_as_drawn_ones(time_scale, weight):
    """A stationary error of unit variance, read at each correction, is compensated evenly."""
    rng, count, each, step = np.random.default_rng(2), 20_000, 4, 0.25
    fade = np.exp(-step / time_scale)
    rows = np.full((5, 1, 1), weight)
    known = KnownError(
        predict_covariance(np.eye(1), rows, np.array([fade]), np.zeros((1, 1))),
        np.arange(17) / each,
    )
    slow = np.exp(-step / each / time_scale)
    error = [rng.standard_normal(count)]
    for _ in range(16):
        error.append(slow * error[-1] + np.sqrt(1.0 - slow**2) * rng.standard_normal(count))
    mean, variance, means = np.zeros(count), 1.0, []
    for drawn in error[::each]:
        means.append(mean)
        gain = variance * weight / (1.0 + variance * weight**2)
        seen = weight * drawn + rng.standard_normal(count)
        mean = fade * (mean + gain * (seen - weight * mean))
        variance = 1.0 - fade**2 * (1.0 - (1.0 - gain * weight) * variance)
    share = np.arange(17) / each
    left = [e - (1 - s % 1) * means[int(s)] - s % 1 * means[min(int(s) + 1, 4)]
            for e, s in zip(error, share, strict=True)]  # fmt: skip
    true = np.var(left, axis=1)
    claimed = known.off[:, 0, 0]
    assert np.all(true < 1.06 * claimed)
    assert np.all(true > 0.8 * claimed)
    np.testing.assert_allclose(true[::each], claimed[::each], rtol=0.06)
    samples = np.var(list(_sampled_errors(known, count, rng)), axis=1)[:, 0]
    np.testing.assert_allclose(samples, claimed[: len(samples)], rtol=0.06)
