"""Against an independent implementation of the published white-noise prior on SE(3)."""

import numpy as np
import pytest

gtsam_wnoa = pytest.importorskip("oracles.gtsam_wnoa")

from glissando import State  # noqa: E402
from glissando.geometry import se3  # noqa: E402
from glissando.model.priors.steps import ARCLENGTH  # noqa: E402
from oracles.steps import between, pair_error  # noqa: E402
from oracles.transitions import full_bridge as bridge  # noqa: E402
from oracles.transitions import process_covariances  # noqa: E402


def random_step(rng, scale, h):
    strain0 = np.array([0, 0, 1.0, 0, 0, 0]) + scale * rng.standard_normal(6)
    strain1 = strain0 + scale * rng.standard_normal(6)
    T0 = se3.exp(rng.standard_normal(6))
    T1 = T0 @ se3.exp(h * strain0) @ se3.exp(0.1 * h * scale * rng.standard_normal(6))
    still = np.zeros((1, 6))
    start = State(T0[None], strain0[None], still)
    return start, State(T1[None], strain1[None], still)


def test_the_published_row_of_grid_dependence_comes_from_its_factors():
    nodes = (5, 9, 17, 33, 65)
    found = [1e3 * gtsam_wnoa.midlength_std(n) for n in nodes]
    print("published form, mid-length standard deviation (mm):", np.round(found, 2))
    assert found == pytest.approx([16.12, 13.46, 12.87, 12.73, 12.69], abs=0.01)
    assert found[0] / found[-1] == pytest.approx(1.27, abs=0.01)


def test_the_noise_of_a_step_meets_the_published_one_where_bending_moves_nothing():
    psd = np.array([1e-3, 1e-3, 1e-3, 4.0, 4.0, 0.5])
    ours, _ = process_covariances(np.zeros((1, 6)), np.array([0.1]), psd, psd, rigid=True)
    assert ours[0] == pytest.approx(gtsam_wnoa.wnoa_covariance(psd, 0.1), rel=1e-9)


@pytest.mark.parametrize("h", [0.05, 0.025])
def test_errors_agree_to_second_order_in_the_step(h):
    """Published rows are [ξ − h ε₀; J_r⁻¹(ξ) ε₁ − ε₀]; ours transport differently at order h²."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        start, end = random_step(rng, 0.5, h)
        theirs, _ = gtsam_wnoa.wnoa_error_and_jacobians(
            start.pose[0], start.strain[0], end.pose[0], end.strain[0], h
        )
        ours = pair_error(ARCLENGTH, start, end, np.array([h]))[0][0]
        scale = np.r_[np.full(6, h**2), np.full(6, h)]
        assert np.all(np.abs(ours - theirs) < 5.0 * scale)


def test_interpolation_meets_the_published_one_as_the_step_shrinks():
    """Both pass through the ends; between them they differ at the order of the step squared."""
    psd = np.array([1e-3, 1e-3, 1e-3, 4.0, 4.0, 0.5])
    worst = []
    for h in (0.1, 0.05, 0.025):
        rng = np.random.default_rng(1)
        gaps = []
        for _ in range(10):
            start, end = random_step(rng, 0.5, h)
            rate = 0.5 * (start.strain + end.strain)
            at = (np.array([h]), np.array([0.4 * h]))
            found = bridge(rate, *at, psd, psd, rigid=True)
            ours = between(ARCLENGTH, start, end, *at, found)[0]
            pose, _ = gtsam_wnoa.wnoa_interpolate(
                start.pose[0], start.strain[0], end.pose[0], end.strain[0], psd, h, 0.4 * h
            )
            gaps.append(np.abs(se3.log(se3.inverse(ours.pose[0]) @ pose)).max())
        worst.append(max(gaps))
    print("largest difference of interpolated poses at h = 0.1, 0.05, 0.025 m:", worst)
    assert worst[1] < 0.4 * worst[0]
    assert worst[2] < 0.4 * worst[1]
