"""The way from three raw exports to a figure is walked as its page says, and ends where it says."""

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest

from glissando.cli.main import main
from glissando.io.netcdf import load_posterior

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "raw-exports.md").read_text(encoding="utf-8")


def commands():
    """The lines of the page's shell blocks, continued ones joined."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    return "".join(blocks).replace("\\\n", " ").strip().splitlines()


def test_the_way_has_few_commands():
    assert 5 <= len(commands()) <= 12


@pytest.mark.slow
def test_the_page_is_walked_from_the_exports_to_the_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said = {}
    for line in commands():
        words = shlex.split(line)
        if words[0] == "python":
            monkeypatch.setattr("sys.argv", words[1:])
            runpy.run_path(str(ROOT / words[1]), run_name="__main__")
        else:
            assert words[0] == "glissando"
            assert main(words[1:]) == 0, line
        said[words[1]] = capsys.readouterr().out
    assert "Where the frame tracker is in the world is not known. Now: glissando calibrate" in (
        " ".join(said["import"].split())
    )
    delay = re.search(r"tracker delay\s+(\S+)\s+(\S+)\s+ms", said["calibrate"])
    found, std = float(delay[1]), float(delay[2])
    assert abs(found + 120.0) < 4.0 * std < 8.0
    assert "underconfident" in said["check"]
    assert (tmp_path / "results" / "view.html").stat().st_size > 100_000
    for name in ("shape.pdf", "confidence.pdf"):
        assert (tmp_path / name).read_bytes().startswith(b"%PDF")
    truth, tip = np.loadtxt(tmp_path / "truth.tum"), np.loadtxt(tmp_path / "tip.tum")
    both = (truth[0, 0] <= tip[:, 0]) & (tip[:, 0] <= truth[-1, 0])
    at = [np.interp(tip[both, 0], truth[:, 0], truth[:, 1 + i]) for i in range(3)]
    off = np.linalg.norm(tip[both, 1:4] - np.transpose(at), axis=1)
    assert both.sum() > 200
    assert np.sqrt(np.mean(off**2)) < 3e-3
    assert load_posterior("results/posterior.nc").solve.converged
