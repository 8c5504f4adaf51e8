"""Sensors and priors of a user's own reach every command, and a plugin's mistake is a sentence."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from glissando import CoilReadings, load_robot
from glissando.io.journal import Journal

OWN = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from glissando import Readings, WhiteNoisePrior
from glissando.model.priors.registry import register_prior


@dataclass(frozen=True, kw_only=True)
class ThreadReadings(Readings, kind="thread"):
    post: np.ndarray
    rows: ClassVar[int] = 1
    value_shape: ClassVar[tuple[int, ...]] = ()
    columns: ClassVar = {"length": "m"}
    settings: ClassVar = {"post": "m"}

    def residual(self, at):
        thread = (at.pose @ self.mount)[:, :3, 3] - self.post
        return np.linalg.norm(thread, axis=1, keepdims=True) - self.values[:, None]


@register_prior
@dataclass(frozen=True)
class Plain(WhiteNoisePrior):
    kind: ClassVar[str] = "plain"
"""


def run(*words):
    command = [str(Path(sys.executable).with_name("glissando")), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A straight robot, a coil at its tip, and a thread from a post to its middle."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "thread_sensor.py").write_text(OWN)
    robot = load_robot("tdcr466")
    time, tip = np.linspace(0.0, 1.0, 31), np.eye(4)
    tip[2, 3] = robot.length
    values = np.tile(tip, (31, 1, 1))
    with Journal("bench") as journal:
        arclength = np.full(31, robot.length)
        journal.write(CoilReadings(time=time, arclength=arclength, values=values, cov=[1e-6] * 5))
    rows = "".join(f"{t},0.233,0.3\n" for t in time)
    (tmp_path / "bench" / "thread.csv").write_text(f"time,arclength,length\n{rows}")
    with (tmp_path / "bench" / "recording.toml").open("a") as stated:
        stated.write('[[streams]]\nname = "thread"\nkind = "thread"\nstd = [0.001]\n')
        stated.write("post = [0.0, 0.3, 0.233]\nkeep_repeats = true\n")
    text = robot.file.read_text().replace('kind = "white-noise"', 'kind = "plain"')
    (tmp_path / "plain.toml").write_text(text)


@pytest.mark.slow
def test_a_sensor_and_a_prior_of_ones_own_reach_every_command(bench):
    request = ["bench", "--robot", "plain.toml"]
    own = ["--plugin", "own/thread_sensor.py"]
    without = run("estimate", *request)
    assert without.returncode == 2
    assert "kind is 'thread'" in without.stderr
    assert "--plugin FILE" in without.stderr
    made = run(*own, "estimate", *request, "--out", "results", "--json")
    assert made.returncode == 0, made.stderr
    assert run("check", "--leave-out", *request, *own).returncode == 0
    again = run(*own, "rerun", "results/report.json")
    assert again.returncode == 0, again.stderr
    exported = ["export", "results/posterior.nc", "--out", "tip.tum"]
    assert run(*exported, *own).returncode == 0
    without = run(*exported)
    assert without.returncode == 2
    assert "'plain' is not a kind of prior" in without.stderr
    assert "--plugin FILE" in without.stderr
    assert "damaged" not in without.stderr
    assert run("rerun", "results/report.json").returncode == 2  # a report starts no program


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("nowhere.py", None, "There is no file nowhere.py; correct --plugin."),
        ("nowhere", None, "The plugin nowhere cannot be imported (ModuleNotFoundError"),
        (
            "broken.py",
            "1 / 0",
            "broken.py cannot be imported (ZeroDivisionError: division by zero)",
        ),
        ("random.py", "", "has the name of another module, random; rename the file."),
    ],
)
def test_a_plugin_that_cannot_be_imported_is_a_sentence(
    tmp_path, monkeypatch, name, text, sentence
):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        (tmp_path / name).write_text(text)
    done = run("--plugin", name, "doctor")
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
