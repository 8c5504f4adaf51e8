import dataclasses

import numpy as np
import pytest

from glissando import GlissandoError, estimate
from glissando.errors import OutsideGridError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.io.labelled_posterior import COMPONENTS
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.model.interpolation import sort_points
from glissando.model.state import DOF
from online import fed
from scenes import LENGTH, sliding_scene


@pytest.fixture(scope="module")
def posterior():
    return estimate(*sliding_scene())


def test_queries_keep_their_shape(posterior):
    assert posterior.at(0.1, 0.5).cov.shape == (18, 18)
    assert posterior.at([0.1, 0.2], 0.5).pose.shape == (2, 4, 4)
    assert posterior.at(np.zeros((3, 1)), np.zeros((1, 4))).strain.shape == (3, 4, 6)
    assert posterior.at([], []).pose.shape == (0, 4, 4)


def test_at_a_node_the_answer_is_the_node(posterior):
    k, n = 3, 2
    at = posterior.at(posterior.grid.arclength[n], posterior.grid.time[k])
    block = slice(n * DOF, (n + 1) * DOF)
    assert at.pose == pytest.approx(posterior.state.pose[k, n])
    assert at.cov == pytest.approx(posterior.marginals.cov[k, block, block])


def test_the_answer_is_continuous_across_grid_lines(posterior):
    time, near = posterior.grid.time[3], 1e-7
    for s in (posterior.grid.arclength[1], 0.2):
        here, there = (posterior.at(s, time + side) for side in (-near, near))
        assert here.pose == pytest.approx(there.pose, abs=1e-5)
        assert np.diag(here.cov) == pytest.approx(np.diag(there.cov), rel=1e-3)


def test_covariances_are_positive_and_largest_between_nodes(posterior):
    s, t = np.meshgrid(np.linspace(0, LENGTH, 13), np.linspace(0, 1, 21))
    cov = posterior.at(s, t).cov
    assert np.linalg.eigvalsh(cov).min() > 0
    assert np.abs(cov - np.swapaxes(cov, -1, -2)).max() == 0


def test_queries_off_the_grid_name_their_rows(posterior):
    with pytest.raises(OutsideGridError, match=r"row 1 has time 2 s, up to 1 s outside"):
        posterior.at(0.1, [0.5, 2.0])


def test_samples_have_the_posterior_covariance(posterior):
    rng = np.random.default_rng(0)
    draws = posterior.sample(rng, 2000)
    step = draws.difference(posterior.state)
    k = 4
    empirical = np.cov(step[:, k].reshape(2000, -1).T)
    exact = posterior.marginals.cov[k]
    scale = np.sqrt(np.diag(exact))
    gap = (empirical - exact) / (scale[:, None] * scale)
    assert np.abs(gap).max() < 6 / np.sqrt(2000)


def test_interpolated_samples_spread_as_the_covariance_between_nodes_less_the_bridge(posterior):
    rng = np.random.default_rng(1)
    s, t = np.array([0.25]), np.array([0.53])
    (points,) = sort_points(posterior.grid, s, t)
    mean = posterior.prior.interpolate(posterior.grid, posterior.state, posterior.state, points)
    draws = posterior.sample(rng, 2000)
    steps = []
    for i in range(2000):
        found = posterior.prior.interpolate(posterior.grid, draws.take(i), posterior.state, points)
        steps.append(found.state.difference(mean.state)[0])
    exact = posterior.at(0.25, 0.53).cov - mean.cov[0]
    ratio = np.var(steps, axis=0) / np.diag(exact)
    assert ratio == pytest.approx(np.ones(18), abs=0.2)


def test_saving_and_loading_gives_the_same_answers(posterior, tmp_path):
    path = tmp_path / "posterior.nc"
    save_posterior(posterior, path)
    again = load_posterior(path)
    s, t = np.array([0.0, 0.11, 0.3]), np.array([0.2, 0.33, 0.4])
    before, after = posterior.at(s, t), again.at(s, t)
    assert after.pose == pytest.approx(before.pose, abs=1e-14)
    assert after.cov == pytest.approx(before.cov, rel=1e-9, abs=1e-18)
    assert again.solve == dataclasses.replace(posterior.solve, seconds={})  # not in files


def test_the_file_speaks_for_itself(posterior, tmp_path):
    xarray = pytest.importorskip("xarray")
    save_posterior(posterior, tmp_path / "posterior.nc")
    with xarray.open_dataset(tmp_path / "posterior.nc", engine="h5netcdf") as dataset:
        assert dataset["position"].dims == ("time", "arclength", "axis")
        assert dataset["position"].attrs["units"] == "m"
        assert dataset["component"].values.tolist() == COMPONENTS[:18]
        std = dataset["std"].sel(component="pose_x").values
        assert std == pytest.approx(posterior.std_pose()[..., 0])
        said = {"units", "convention"}
        assert not [name for name, held in dataset.data_vars.items() if not said & {*held.attrs}]
        assert "T_wb" in dataset["pose"].attrs["frame"]


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "other.nc").write_bytes(b"no netcdf")
    with pytest.raises(GlissandoError, match="cannot be read as NetCDF"):
        load_posterior(tmp_path / "other.nc")


def test_the_window_of_a_smoother_is_read_as_it_was_saved(tmp_path):
    """Its first node stands for the time since the node before it, which left the window."""
    prior, grid, readings = sliding_scene()
    smoother = FixedLagSmoother(prior, grid.arclength, window=3)
    fed(smoother, grid, readings)
    window = smoother.posterior()
    save_posterior(window, tmp_path / "window.nc")
    again = load_posterior(tmp_path / "window.nc")
    assert again.grid.before == window.grid.before is not None
    where = np.linspace(0.0, LENGTH, 9), window.grid.time[0] + np.linspace(0.0, 0.1, 9)
    np.testing.assert_allclose(again.at(*where).cov, window.at(*where).cov, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("span", [0.0, -1.0, np.nan])
def test_a_node_that_stands_for_no_time_is_a_damaged_file(tmp_path, span):
    h5netcdf = pytest.importorskip("h5netcdf")
    prior, grid, _ = sliding_scene()
    save_posterior(estimate(prior, grid.at_times(grid.time[:1]), []), tmp_path / "one.nc")
    load_posterior(tmp_path / "one.nc")
    with h5netcdf.File(tmp_path / "one.nc", "a") as file:
        file.attrs["time_span"] = span
    with pytest.raises(GlissandoError, match="its node stands for"):
        load_posterior(tmp_path / "one.nc")
