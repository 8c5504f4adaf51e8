"""Confidence over arclength and time is a claim: motions drawn from the separable prior judge it.

Truth is drawn on 40 arclength steps and fine times, nothing linearised but the noise's weight;
noisy readings of it, most of them at time nodes, are estimated on 5 × 9 nodes. The normalised
error squared of pose, strain and velocity must be 1 per degree of freedom at nodes and between.
"""

import numpy as np
import pytest

from separable_sessions import (
    judge,
    normalised_errors,
)


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says_at_nodes_and_between():
    for name, verdict in judge(normalised_errors(1.0, 50)).items():
        assert np.all(verdict), name


@pytest.mark.slow
@pytest.mark.parametrize("inflate", [1.3, 1 / 1.3])
def test_noise_misjudged_by_a_third_fails_the_same_test(inflate):
    print(f"noise × {inflate:.2f}")
    verdicts = judge(normalised_errors(inflate, 35))
    assert not np.all(verdicts["all"])
    assert not np.all(verdicts["pose"])
