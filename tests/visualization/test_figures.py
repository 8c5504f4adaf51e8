"""Figures are drawn into any axes, as any file, and their confidence is 95 % everywhere."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import chi2

from glissando import GlissandoError, PoseReadings, estimate, load_robot, save_posterior
from glissando.cli.main import main
from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.visualization.canvas import BAND, save_figure
from glissando.visualization.evaluation_figures import radius95
from glissando.visualization.figures import confidence_figure, error_figure
from glissando.visualization.shape_figure import draw_ellipsoids, shape_figure


@pytest.fixture(scope="module")
def scene():
    robot = load_robot("tdcr466")
    tip = np.tile(np.eye(4), (5, 1, 1))
    tip[:, 2, 3] = robot.length
    time, place = np.linspace(0, 0.2, 5), np.full(5, robot.length)
    seen = PoseReadings(time=time, arclength=place, values=tip, cov=1e-6, name="tip")
    return estimate(robot.prior, robot.grid(0.0, 0.2), [seen]), [seen]


@pytest.mark.slow
def test_a_figure_is_drawn_into_given_axes_and_returns_them(scene):
    posterior, streams = scene
    page = Figure(figsize=(8, 6))
    flat = page.add_subplot(2, 1, 1)
    assert confidence_figure(posterior, streams, ax=flat) is flat
    assert flat.get_xlabel() == "time (s)"
    space = page.add_subplot(2, 1, 2, projection="3d")
    assert shape_figure(posterior, streams, [0.1], ax=space, style={"font.size": 6}) is space
    assert space.get_legend().get_texts()[0].get_size() == pytest.approx(6)
    three = Figure().subplots(1, 3)
    drawn = error_figure(posterior, streams, ax=three)
    assert drawn.shape == (1, 3)
    assert drawn[0, 0] is three[0]
    with pytest.raises(GlissandoError, match="1 × 3 axes; 1 were given"):
        error_figure(posterior, streams, ax=flat)


def test_shapes_are_told_apart_also_since_1970():
    robot, start = load_robot("tdcr466"), 1.7e9
    posterior = estimate(robot.prior, robot.grid(start, start + 0.2), [])
    axes = shape_figure(posterior, [], [start, start + 0.125])
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert labels[:2] == ["1700000000 s", "1700000000.125 s"]
    with pytest.raises(GlissandoError, match=r"outside \[1700000000, 1700000000.2\] s"):
        posterior.at(0.1, start + 0.5)


@pytest.mark.slow
def test_a_figure_of_its_own_has_the_size_that_is_asked_for(scene):
    axes = confidence_figure(*scene, size=(3.4, 2.0), style={"font.size": 7})
    assert axes.figure.get_size_inches().tolist() == [3.4, 2.0]
    assert axes.xaxis.get_label().get_size() == pytest.approx(7)


def test_bands_and_ellipsoids_hold_95_percent(scene):
    """The band of a component is 1.96 and an ellipsoid 2.80 standard deviations wide."""
    assert pytest.approx(chi2.ppf(0.95, 1)) == BAND**2
    assert pytest.approx(chi2.ppf(0.95, 3)) == SIGMAS_95**2
    posterior, streams = scene
    drawn = error_figure(posterior, streams)[0, 2]
    at = posterior.at(streams[0].arclength, streams[0].time)
    wide = BAND * 1e3 * np.sqrt(at.cov_position_world[:, 2, 2] + 1e-6)
    (band,) = drawn.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(wide.max(), rel=1e-6)
    at = posterior.at([0.3], [0.1])
    corners = draw_ellipsoids(
        shape_figure(posterior, [], [0.1]), at.position, at.cov_position_world, "black"
    )
    half = 0.5 * np.ptp(np.stack(corners), axis=0)[0]
    cov = posterior.at([0.3], [0.1]).cov_position_world[0]
    np.testing.assert_allclose(half, 1e3 * SIGMAS_95 * np.sqrt(np.diagonal(cov)), rtol=1e-6)


def test_the_radius_holds_95_percent_of_errors_of_any_covariance():
    rng = np.random.default_rng(0)
    for _ in range(5):
        root = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-1, 1, 3)
        errors = rng.standard_normal((40_000, 3)) @ root.T
        inside = np.linalg.norm(errors, axis=1) <= radius95(root @ root.T)
        assert 0.94 < inside.mean() < 0.96


@pytest.mark.parametrize(
    ("ending", "begins"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<")]
)
def test_the_ending_of_a_file_chooses_its_format(tmp_path, ending, begins):
    path = save_figure(Figure(figsize=(1, 1)), tmp_path / f"a.{ending}")
    assert path.read_bytes().startswith(begins)
    with pytest.raises(GlissandoError, match="end it in"):
        save_figure(Figure(), tmp_path / "a.bmp")


def test_a_figure_without_room_for_its_axes_is_refused(scene, tmp_path, capsys):
    small = error_figure(*scene, size=(1.0, 0.7))
    with pytest.raises(GlissandoError, match=r"25\.4 × 17\.8 mm has no room"):
        save_figure(small, tmp_path / "e.png")
    assert not any(tmp_path.iterdir())
    with pytest.raises(GlissandoError, match="88 × 60 inches cannot be; give a size in inches"):
        confidence_figure(*scene, size=(88.0, 60.0))
    for size in ("88000,60", "3.5,2.4"):
        assert main(["figure", "shape", "r", "--size", size, "--out", str(tmp_path / "s.png")]) == 2
        assert f"--size {size}: give width and height in mm, from 10" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--out a.bmp", "'a.bmp' is not a figure: end it in"),
        ("--out a.png --font-size inf", "--font-size inf: give points, up to 100"),
        ("--out a.png --times ,", "--times names no time"),
        ("--out a.png --size ,", "give width and height in mm"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_an_estimate(capsys, words, said):
    assert main(["figure", "shape", "nowhere", *words.split()]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_draws_what_is_asked_for(scene, tmp_path, capsys):
    save_posterior(scene[0], tmp_path / "posterior.nc")
    call = ["figure", "confidence", str(tmp_path), "--out", str(tmp_path / "c.svg")]
    assert main([*call, "--size", "80,80", "--font-size", "7"]) == 0  # square, too
    assert main([*call, "--size", "80,50", "--font-size", "7"]) == 0
    text = (tmp_path / "c.svg").read_text()
    assert 'width="226.771654pt"' in text  # 80 mm
    assert "arclength (mm)" in text  # letters stay letters
    assert main([*call, "--size", "80"]) == 2
    assert "give width and height in mm" in capsys.readouterr().err
    assert main(["figure", "error", str(tmp_path), "--out", str(tmp_path / "e.pdf")]) == 2
    assert "give the folder that does with --recording" in capsys.readouterr().err
