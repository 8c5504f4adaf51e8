"""Forces are drawn as arrows with the ellipsoids of their tips: in figures, films and on pages."""

import warnings

import numpy as np
import pytest
from PIL import Image

from browser import Told, chromium, screenshot_once, wait_until
from glissando import CoilReadings, FalseConfidenceWarning, Grid, estimate
from glissando.estimation.confidence_tube import SIGMAS_95
from glissando.visualization.arrows import arrows_of
from glissando.visualization.canvas import MM, save_figure
from glissando.visualization.film import save_animation
from glissando.visualization.page import save_view
from glissando.visualization.shape_figure import shape_figure
from mechanical_rod import NODES_S, POINT, mechanical
from pages import carried, unpacked
from scenes import judged_scene

TIME = np.array([0.0, 0.5])


@pytest.fixture(scope="module")
def posterior():
    """A rod that bears its weight and is seen at all nodes by a coil, at two times."""
    prior, grid = mechanical(), Grid(NODES_S, TIME)
    place, time = np.tile(NODES_S, 2), np.repeat(TIME, NODES_S.size)
    pose = prior.rest_state(grid).pose.reshape(-1, 4, 4).copy()
    pose[:, 0, 3] += 0.3 * place**2  # as something pulls along x
    coil = CoilReadings(time=time, arclength=place, values=pose, cov=np.full(5, 1e-6))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FalseConfidenceWarning)  # it knows of no pull
        return estimate(prior, grid, [coil])


def test_an_arrow_begins_on_the_robot_and_its_tip_and_ellipsoid_are_those_of_the_force(posterior):
    arrows = arrows_of(posterior, TIME)
    load = posterior.load([POINT, 0.4], TIME[:, None], frame="world")
    lines, rings = arrows.strokes(), arrows.rings()
    at = posterior.at([POINT, 0.4], TIME[:, None])
    np.testing.assert_allclose(lines[:, :, 0], at.position, atol=1e-9)
    newtons = (lines[:, :, 1] - lines[:, :, 0]) * arrows.unit / arrows.length
    np.testing.assert_allclose(newtons, load.force, atol=1e-9)
    off = (rings - lines[:, :, 1:2]) * arrows.unit / arrows.length
    size = np.einsum("fpsi,fpsi->fps", off, np.linalg.solve(
        load.cov[:, :, None, :3, :3], off[..., None])[..., 0])  # fmt: skip
    drawn = np.isfinite(size)
    np.testing.assert_allclose(size[drawn], SIGMAS_95**2, rtol=1e-6)
    assert drawn.sum(axis=-1).min() > 90
    longest = np.linalg.norm(lines[:, :, 1] - lines[:, :, 0], axis=-1).max()
    assert longest < 0.4 * NODES_S[-1]


def test_a_prior_that_knows_no_loads_has_no_arrows():
    posterior, _, _ = judged_scene()
    assert arrows_of(posterior, posterior.grid.time) is None


def _coloured(picture):
    """How many pixels have the hue of arrows, lit or in shade."""
    red, green, blue = np.moveaxis(np.asarray(picture.convert("RGB"), dtype=float), -1, 0)
    return int(np.sum((red > 130) & (red > blue) & (red - green > 40) & (blue - green > 15)))


@pytest.mark.slow
def test_figures_and_films_show_the_arrows(posterior, tmp_path):
    axes = shape_figure(posterior, [], [0.5])
    tip = MM * arrows_of(posterior, TIME).strokes()[1, :, 1]
    lines = [np.stack(line.get_data_3d(), axis=-1) for line in axes.get_lines()]
    for point in tip:
        assert min(np.nanmin(np.linalg.norm(line - point, axis=-1)) for line in lines) < 1e-6
    words = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert any(word.startswith("force, 95 %") for word in words)
    limits = axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()
    for low_high, component in zip(limits, tip.T, strict=True):
        assert np.all((component > low_high[0]) & (component < low_high[1]))
    save_figure(axes, tmp_path / "shape.png")
    film = save_animation(posterior, [], [], tmp_path / "film.gif", seconds=0.2, rate=5, width=300)
    with Image.open(film) as picture:
        assert _coloured(picture) > 30


@pytest.mark.slow
def test_a_page_carries_forces_and_draws_them_unless_they_are_switched_off(posterior, tmp_path):
    file = save_view(posterior, tmp_path / "view.html")
    told = carried(file.read_text())["arrows"]
    load = posterior.load(told["place"], TIME[:, None], frame="world")
    scale, ends = told["length"] / told["unit"], [0, -1]
    np.testing.assert_allclose(
        unpacked(told["force"])[ends], scale * load.force, atol=told["force"]["step"]
    )
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 900, "height": 800}, color_scheme="light")
        problems = Told(page)
        page.goto(file.as_uri())
        wait_until(page, "!state.waiting && state.moment >= 0")
        drawn = screenshot_once(page, lambda picture: _coloured(picture) > 100)
        page.locator("#forces input").click()
        wait_until(page, "!state.waiting")
        hidden = screenshot_once(page, lambda picture: _coloured(picture) < 10)
        assert page.locator("#now").inner_text().count("force at") == 2
        assert _coloured(drawn) > 100 > 10 * _coloured(hidden)
        assert problems == []
