"""Rerun is told what the estimate says, in a file that can be read again."""

import numpy as np
import pytest

from glissando import GlissandoError, estimate
from glissando.cli.main import main
from glissando.visualization.page import Rerun
from scenes import sliding_scene

rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed")


@pytest.fixture(scope="module")
def posterior():
    prior, grid, readings = sliding_scene(duration=0.5)
    return estimate(prior, grid, readings)


def told(posterior, time):
    at = posterior.at(posterior.grid.arclength, time)
    return time, at.position, at.pose, at.cov_position_world


def test_a_file_holds_every_moment_with_body_coil_and_spread(posterior, tmp_path):
    file = tmp_path / "run.rrd"
    with Rerun(posterior.grid.arclength, str(file)) as view:
        for time, coil in ((0.0, 0.4), (0.25, None), (0.5, 0.3)):
            view.update(*told(posterior, time), coil)
    held = file.read_bytes()
    assert held.startswith(b"RRF")
    for entity in (b"robot/tube", b"robot/body", b"robot/coil", b"std_mm/tip"):
        assert entity in held


def test_the_command_tells_rerun_of_a_posterior(posterior, tmp_path, capsys):
    posterior.save(tmp_path / "posterior.nc")
    target = tmp_path / "told.rrd"
    assert main(["view", str(tmp_path / "posterior.nc"), "--rerun", str(target)]) == 0
    assert "moments" in capsys.readouterr().out
    assert target.stat().st_size > 10_000


def test_what_is_neither_a_file_nor_a_viewer_is_refused_in_a_sentence():
    with pytest.raises(GlissandoError, match=r"give a file name that ends in \.rrd"):
        Rerun(np.linspace(0.0, 1.0, 5), "somewhere")
