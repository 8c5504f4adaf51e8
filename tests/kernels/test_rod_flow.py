"""The compiled path of a loaded rod is the oracle's, with its slopes and its noise."""

import numpy as np
import pytest

from glissando.geometry import se3
from glissando.model.priors.mechanical.flow import Section, flow
from oracles import rod_flow


@pytest.mark.parametrize("noisy", [True, False])
def test_the_compiled_path_of_a_rod_is_the_oracles(noisy):
    rng, m = np.random.default_rng(3), 40
    stiffness = np.exp(rng.uniform(0.0, 8.0, (m, 6))) * np.repeat([1e2, 1e-2], 3)
    rest = np.concatenate([np.tile([0.0, 0, 1], (m, 1)), rng.standard_normal((m, 3))], axis=1)
    slope, psd = 0.3 * rng.standard_normal((m, 6)), rng.uniform(0.0, 1.0, (m, 12))
    weight, weight_slope = rng.standard_normal((2, m, 3))
    section = Section(stiffness, rest, slope, weight, psd, weight_slope)
    start = se3.exp(rng.standard_normal((m, 6)))[:, :3, :3], 0.1 * rng.standard_normal((m, 6))
    step = rng.uniform(0.01, 0.1, m)
    found = flow(*start, step, section, noisy=noisy)
    its = rod_flow.flow(*start, step, section, noisy=noisy)
    for name, value in vars(its).items():
        scale = np.abs(value).max(initial=1e-12)
        np.testing.assert_allclose(getattr(found, name) / scale, value / scale, atol=1e-12)
