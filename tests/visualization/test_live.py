"""A running estimate in a browser: what a server is told is what a browser shows."""

import sys

import numpy as np
import pytest

from browser import Told, chromium
from glissando import FixedLagSmoother, GlissandoError, estimate
from glissando.cli.main import main
from glissando.io.netcdf import save_posterior
from glissando.visualization.page import Live, scene_of
from glissando.visualization.page import live as live_module
from scenes import sliding_scene

pytest.importorskip("viser", reason="viser is not installed")


@pytest.fixture(scope="module")
def posterior():
    prior, grid, readings = sliding_scene(duration=0.5)
    return estimate(prior, grid, readings)


@pytest.fixture
def shown(posterior):
    with Live(posterior.grid.arclength, port=0) as live:
        yield live


def told(posterior, time):
    at = posterior.at(posterior.grid.arclength, time)
    return time, at.position, at.pose, at.cov_position_world


def test_an_update_moves_the_body_the_tube_and_the_coil(posterior, shown):
    shown.update(*told(posterior, 0.0), 0.4)
    before = [np.array(shown._body.points), np.array(shown._tube.vertices)]
    assert shown._coil.visible
    at = posterior.at([0.4], 0.0).position[0]
    assert np.linalg.norm(np.array(shown._coil.position) - at) < 0.02  # on the chord of nodes
    shown.update(*told(posterior, 0.5))
    assert not shown._coil.visible
    line = posterior.at(posterior.grid.arclength, 0.5).position
    np.testing.assert_allclose(shown._body.points[:, 0], line[:-1], atol=1e-6)
    np.testing.assert_allclose(shown._body.points[:, 1], line[1:], atol=1e-6)
    assert np.abs(before[1] - shown._tube.vertices).max() > 1e-3


def test_a_smoother_feeds_it_as_it_is():
    prior, grid, readings = sliding_scene(duration=0.3)
    smoother = FixedLagSmoother(prior, grid.arclength)
    with Live(grid.arclength, port=0) as live:
        for time in grid.time:
            for stream in readings:
                now = stream.select(np.abs(stream.time - time) < 1e-6)
                smoother.add(now)
            at = smoother.advance(time)
            live.update(time, at.position, at.pose, at.cov_position_world, 0.4)
        assert f"**{grid.time[-1]:.2f} s**" in live._text.content
        assert f"tip ± {1e3 * at.std_position[-1]:.1f} mm" in live._text.content


def test_shapes_that_do_not_fit_are_one_sentence(posterior, shown):
    time, centres, frames, cov = told(posterior, 0.0)
    with pytest.raises(GlissandoError, match=r"does not fit 4 arclengths; give \(\(4, 3\), "):
        shown.update(time, centres[:-1], frames, cov)


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_a_port_that_cannot_be_is_a_sentence(port):
    with pytest.raises(GlissandoError, match=f"A port of {port} cannot be; give 0 to 65535"):
        Live(np.linspace(0.0, 1.0, 3), port=port)


def test_without_viser_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(GlissandoError, match=r"needs viser .* pip install 'glissando\[view\]'"):
        Live([0.0, 1.0])


def test_the_command_plays_until_it_is_interrupted(posterior, tmp_path, monkeypatch, capsys):
    save_posterior(posterior, tmp_path / "posterior.nc")
    seen = []

    def stop(seconds):
        seen.append(seconds)
        if len(seen) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(live_module.clock, "sleep", stop)
    monkeypatch.chdir(tmp_path)
    assert main(["view", "posterior.nc", "--live", "--port", "0"]) == 130
    assert "Playing at http://127.0.0.1:" in capsys.readouterr().out
    assert seen == pytest.approx([0.05] * 3)
    assert not (tmp_path / "view.html").exists()


def test_only_this_machine_is_served(shown):
    assert shown.address.startswith("http://127.0.0.1:")
    assert shown._server.get_host() == "127.0.0.1"


@pytest.mark.slow
def test_a_browser_shows_it_without_another_server(posterior, shown):
    scene = scene_of(posterior)
    with chromium() as browser:
        page = browser.new_page()
        asked = Told(page)
        page.goto(shown.address)
        shown.update(*told(posterior, scene.time[-1]), 0.3)
        page.get_by_text("coil at 300 mm").wait_for(timeout=20_000)
        outside = [a for a in asked if a.startswith("http") and shown.address not in a]
        assert outside == []
