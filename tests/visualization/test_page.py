"""What a page of the robot over time carries, and that it needs nothing else."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from glissando import GlissandoError, Grid
from glissando.cli.main import main
from glissando.errors import OutsideGridError
from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.geometry import se3
from glissando.geometry.covariance import symmetric_root
from glissando.io.netcdf import save_posterior
from glissando.visualization.page import Scene, page, save_view, scene_of
from glissando.visualization.page.page import packed
from glissando.visualization.page.scene import moments
from pages import OUTSIDE, carried, unpacked
from scenes import LENGTH, judged_scene


@pytest.fixture(scope="module")
def run():
    return judged_scene()


@pytest.fixture(scope="module")
def html(run, tmp_path_factory):
    posterior, readings, truth = run
    path = tmp_path_factory.mktemp("view") / "new" / "view.html"
    assert save_view(posterior, path, readings=readings, truth=truth, title="a <b> & c") == path
    return path.read_text(encoding="utf-8")


def random_scene(moments_, points, sensors, sites, seed=0):
    """A scene of numbers without sense, to weigh a page with."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((moments_, points, 3, 3))
    return Scene(
        time=np.linspace(0.0, 15.0, moments_),
        arclength=np.linspace(0.0, 0.7, points),
        pose=se3.exp(rng.standard_normal((moments_, points, 6))),
        root=root + np.swapaxes(root, -1, -2),
        sensors=[f"sensor {i}" for i in range(sensors)],
        place=rng.uniform(0.0, 0.7, (moments_, sensors)),
        sites=[f"site {i}" for i in range(sites)],
        site_place=rng.uniform(0.0, 0.7, (moments_, sites)),
        truth=rng.standard_normal((moments_, sites, 4, 3)),
        miss=rng.uniform(0.0, 0.1, (moments_, sites)),
        nees=rng.uniform(0.0, 9.0, (moments_, sites)),
    )


@given(arrays(float, array_shapes(max_dims=3), elements=st.floats(-1e3, 1e3) | st.just(np.nan)))
def test_packing_keeps_every_number_to_half_its_step_and_what_is_missing_missing(values):
    entry = packed(values)
    again = unpacked(entry)
    assert np.array_equal(np.isnan(again), np.isnan(values))
    off = np.nan_to_num(np.abs(again - values))
    assert off.max() <= 0.5 * entry["step"] * (1.0 + 1e-9) + 1e-12
    known = values[~np.isnan(values)]
    if known.size:
        assert entry["step"] == pytest.approx(np.ptp(known) / 65534)


@given(arrays(float, (3, 3), elements=st.floats(-1.0, 1.0)))
def test_a_symmetric_root_is_symmetric_and_its_square_is_the_covariance(half):
    cov = half @ half.T
    root = symmetric_root(cov)
    np.testing.assert_allclose(root, root.T, atol=1e-12)
    np.testing.assert_allclose(root @ root, cov, atol=1e-9)
    assert np.linalg.eigvalsh(root).min() >= -1e-12


@settings(max_examples=60)
@given(
    st.lists(st.floats(0.01, 3.0), min_size=1, max_size=40),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
@example([2.0], 0.0, np.finfo(float).eps)
def test_moments_hold_the_nodes_are_close_and_never_too_many(steps, one, other):
    nodes = np.concatenate([[2.0], 2.0 + np.cumsum(steps)])
    first, last = np.interp(sorted([one, other]), [0.0, 1.0], nodes[[0, -1]])
    times = moments(nodes, (first, last))
    assert times[[0, -1]] == pytest.approx([first, last])
    assert times.size <= 1500
    assert times.size == 1 or np.all(np.diff(times) > 0.0)
    inside = nodes[(nodes >= first) & (nodes <= last)]
    if times.size < 1500:
        assert np.abs(times[:, None] - inside).min(axis=0).max(initial=0.0) < 1e-9
        assert times.size - 1 >= 20.0 * (last - first) - 1e-6


def test_every_moment_is_asked_of_the_posterior(run):
    posterior, readings, truth = run
    scene = scene_of(posterior, readings, truth)
    at = posterior.at(scene.arclength, scene.time[:, None])
    np.testing.assert_allclose(scene.pose, at.pose, atol=1e-12)
    np.testing.assert_allclose(scene.root @ scene.root, at.cov_position_world, atol=1e-12)
    assert scene.time.size == 21  # ten intervals of 0.1 s, each at its middle as well


def test_sensors_are_where_they_read_and_truth_is_as_far_off_as_it_is(run):
    posterior, readings, truth = run
    scene = scene_of(posterior, readings, truth)
    coil = scene.sensors.index("coil")
    shown = ~np.isnan(scene.place[:, coil])
    near = np.abs(scene.time[:, None] - readings[1].time).min(axis=1)
    assert np.array_equal(shown, near <= 0.25)
    rows = np.abs(scene.time[shown, None] - readings[1].time).argmin(axis=1)
    np.testing.assert_allclose(scene.place[shown, coil], readings[1].arclength[rows])
    seen = ~np.isnan(scene.miss[:, 0])
    assert np.array_equal(seen, scene.time < 0.41)
    for k in np.flatnonzero(seen):
        row = np.abs(truth[0].time - scene.time[k]).argmin()
        at = posterior.at(truth[0].arclength[row], truth[0].time[row])
        off = truth[0].values[row, :3, 3] - at.position
        assert scene.miss[k, 0] == pytest.approx(np.linalg.norm(off))
        cov = at.cov_position_world + 1e-6 * np.eye(3)
        assert scene.nees[k, 0] == pytest.approx(off @ np.linalg.solve(cov, off))


def test_a_page_decodes_to_the_posterior_within_the_step_it_states(run, html):
    posterior = run[0]
    told = carried(html)
    at = posterior.at(told["arclength"], np.array(told["time"])[:, None])
    centre, root = unpacked(told["centre"]), unpacked(told["root"])
    full = root[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*root.shape[:2], 3, 3)
    turn = se3.rotation_from_quaternion(unpacked(told["quaternion"]))
    assert np.abs(centre - at.position).max() <= 0.51 * told["centre"]["step"]
    assert np.abs(full - symmetric_root(at.cov_position_world)).max() <= 0.51 * told["root"]["step"]
    assert np.abs(turn - at.pose[..., :3, :3]).max() < 2e-4
    std = np.linalg.norm(full, axis=(-2, -1))
    np.testing.assert_allclose(std, at.std_position, atol=3.0 * told["root"]["step"])
    stated = float(re.search(r"rounded by up to ([\d.e-]+) mm", html)[1])
    worst = 500.0 * max(told[name]["step"] for name in ("centre", "root"))
    assert stated == pytest.approx(worst, rel=0.1)
    assert stated < 0.01
    assert told["sigmas"] == SIGMAS_95 == pytest.approx(2.7955, abs=1e-4)


def test_a_page_needs_nothing_else_and_takes_names_as_they_are(html):
    assert not OUTSIDE.search(html)
    assert "default-src 'none'" in html
    assert "<title>a &lt;b&gt; &amp; c</title>" in html
    tags = re.findall(r"<(script|style|link|iframe|img)\b", html)
    assert sorted(tags) == ["script", "script", "style"]


def test_a_name_cannot_end_the_script_that_carries_it():
    scene = replace(random_scene(2, 3, 1, 0), sensors=["</script><b>"])
    html = page(scene, "t", "s")
    assert "</script><b>" not in html
    assert carried(html)["sensors"] == ["</script><b>"]


def test_no_page_is_heavier_than_5_mb_however_long_the_run():
    longest = random_scene(1500, 49, 6, 12)
    assert len(page(longest, "t", "s").encode()) < 5e6
    assert len(page(random_scene(301, 49, 2, 6), "t", "s").encode()) < 1.2e6  # 15 s


def test_a_part_is_shown_by_its_window_and_another_is_refused(run):
    scene = scene_of(run[0], window=(0.25, 0.5))
    assert scene.time[[0, -1]] == pytest.approx([0.25, 0.5])
    for window in ((0.5, 2.0), (0.6, 0.4), (np.nan, 1.0)):
        with pytest.raises(OutsideGridError, match=r"not inside the estimate, 0 to 1 s; give one"):
            scene_of(run[0], window=window)


def test_progress_ends_with_all_moments(run):
    told = []
    scene_of(run[0], progress=lambda *at: told.append(at))
    assert told == [(21, 21)]


def test_a_single_arclength_is_refused(run):
    posterior = replace(run[0], grid=Grid([LENGTH], run[0].grid.time))
    with pytest.raises(GlissandoError, match="has no body to show"):
        scene_of(posterior)


def test_the_command_shows_a_posterior_with_the_sensors_and_truth_of_its_recording(
    run, tmp_path, capsys
):
    posterior, _, truth = run
    (tmp_path / "run").mkdir()
    save_posterior(posterior, tmp_path / "run" / "posterior.nc")
    recording = tmp_path / "recording"
    recording.mkdir()
    (recording / "recording.toml").write_text(
        'name = "bench"\nrobot = "tdcr466"\n'
        '[[streams]]\nname = "coil"\nkind = "position"\nstd = [0.001, 0.001, 0.001]\n'
        '[[streams]]\nname = "seen"\nkind = "position"\ntruth = true\n'
    )
    rows = np.column_stack([truth[0].time, truth[0].arclength, truth[0].values[:, :3, 3]])
    for name in ("coil", "seen"):
        head = {"header": "time,arclength,x,y,z", "comments": ""}
        np.savetxt(recording / f"{name}.csv", rows, "%.17g", ",", **head)
    out = tmp_path / "out.html"
    arguments = ["view", tmp_path / "run", "--recording", recording, "--html", out]
    assert main([str(a) for a in [*arguments, "--window", 0, 0.5]]) == 0
    assert f"Wrote {out}; open it" in capsys.readouterr().out
    told = carried(out.read_text())
    assert (told["sensors"], told["sites"]) == (["coil"], ["seen"])
    assert told["time"][-1] == 0.5
    assert "<h1>bench</h1><p>0 to 0.5 s; estimate converged" in out.read_text()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere"], "no recording folder or posterior 'nowhere'; give one"),
        (["{here}"], "holds no recording.toml and no CSV"),
        (["{here}/posterior.nc", "--html", "{here}/no/such/view.html"], "posterior.nc"),
        (["{here}/page", "--html", "{here}/page/view.html"], "is not a folder that can be written"),
    ],
)
def test_a_mistake_is_one_sentence_and_status_2(tmp_path, capsys, arguments, sentence):
    (tmp_path / "page").write_text("in the way")
    given_ = [a.replace("{here}", str(tmp_path)) for a in arguments]
    assert main(["view", *given_]) == 2
    told = capsys.readouterr().err
    assert sentence in told
    assert told.startswith("glissando: ")
    assert told.count("\n") == 1


@pytest.mark.slow
def test_a_simulated_15_s_run_is_a_page_of_less_than_5_mb(tmp_path, capsys):
    recording, out = tmp_path / "recording", tmp_path / "out"
    simulated = ["--shape", "S", "--slide", "oscillate", "--duration", 15, "--out", recording]
    assert main(["simulate", *map(str, simulated)]) == 0
    assert main(["estimate", str(recording), "--view", "--out", str(out)]) == 0
    html = (out / "view.html").read_text()
    print(f"15 s: {len(html.encode()) / 1e6:.2f} MB")
    assert len(html.encode()) < 5e6
    told = carried(html)
    assert (told["sensors"], len(told["sites"])) == (["coil"], 6)
    assert told["time"][-1] == pytest.approx(15.0, abs=0.1)
    slid = unpacked(told["place"])
    assert np.nanmax(slid) - np.nanmin(slid) > 0.05
