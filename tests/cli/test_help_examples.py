"""The examples in every command's help are lines that can be typed, and one of each does run."""

import argparse
import re
import shlex
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from glissando.cli.main import build_parser, main
from glissando.evaluation.run import run_estimate, write_run
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file
from glissando.simulation import SlidePath, load_bench, simulate_session, write_session
from outputs import Renamed, watched


def commands():
    """Parsers by the names of their commands."""
    parser = build_parser()
    (sub,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return sub.choices


def examples(name):
    """Lines of a command's help that begin with `glissando`, continued ones joined."""
    text = commands()[name].format_help().replace("\\\n", " ")
    lines = re.findall(r"^  (glissando .*)$", text, re.M)
    return [line.split("  #")[0].split(" | ")[0].split(" > ")[0] for line in lines]


ALL = [(name, line) for name in commands() for line in examples(name)]

RUNS = {  # what must stand in the line that is run, and what makes it quick; or why none is
    "estimate": ("--query", ""),
    "check": ("my_recording --json", ""),
    "robot": ("--sensors coil", ""),
    "learn": ("--only noise", "--window 0 1 --steps 1"),
    "replay": ("my_recording --json", ""),
    "live": ("csv:newest.csv", ""),
    "simulate": ("--slide hold", "--duration 1"),
    "plan": ("--robot sliding700", "--horizon 1"),
    "design": ("--out design", "--horizon 1 --strokes 0.06"),
    "study": ("--out results", "--workers 1"),
    "view": ("view results --recording my_recording", ""),
    "figure": ("--font-size 7", ""),
    "rerun": ("results/report.json --json", ""),
    "report": ("report results/fixed", ""),
    "record": "its devices take as long as real ones: tests/hardware/test_rig.py runs it",
    "calibrate": "it wants a recorded session: tests/hardware/test_rig.py runs it",
    "import": ("take3.csv --rate", ""),
    "export": ("--out tip.tum", ""),
    "predict": "it wants a robot with tendons: tests/cli/test_tendon_commands.py runs it",
    "doctor": ("--json", ""),
    "reproduce": "even --quick takes long: tests/experiments/test_experiments.py runs it",
}
"""A command that is new says here what runs."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with all that the examples name, made of one second of simulation."""
    folder = tmp_path_factory.mktemp("help")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        known = load_bench(robot_file("sliding700"))
        motion = known.move(known.shape("C"), known.flaws, seed=0)
        path = SlidePath.hold(0.0, 2.0, known.slide)
        session = simulate_session(known, motion, path, seed=0, duration=2.0)
        write_session(session, Path("my_recording"), "sliding700")
        for name in ("slow", "first", "second", "fixed", "sliding"):
            shutil.copytree("my_recording", name)
        shutil.copy(robot_file("sliding700"), "my_robot.toml")
        Path("points.csv").write_text("time,arclength\n0.5,0.3\n1.0,0.7\n")
        Path("sweep.toml").write_text(
            'name = "s"\nseeds = 1\n[fixed]\nshape = "C"\nduration = 2\n[grid]\nnoise = [1]\n'
        )
        head = "Objects\n100\n,,tip,,,,,,mid,,,,,\nFrame,Sub Frame" + ",RX,RY,RZ,TX,TY,TZ" * 2
        rows = [f"{k},0" + ",0,0,0,1,2,300" * 2 for k in range(1, 6)]
        Path("take3.csv").write_text(
            "\n".join([head, "," + ",rad,rad,rad,mm,mm,mm" * 2, *rows]) + "\n"
        )
        recording = load_recording("my_recording")
        run = run_estimate(recording, recording.robot, window=None, use=None, truth=None)
        for out in map(Path, ("results", "results/fixed", "results/sliding")):
            out.mkdir()
            write_run(run, out, request=["estimate", "my_recording"], inputs={})
    return folder


@pytest.mark.parametrize(("name", "line"), ALL)
def test_every_example_can_be_typed(name, line):
    words = shlex.split(line)[1:]
    if words[0] not in commands():
        pytest.skip(f"the command {words[0]} is not part of this version")
    build_parser().parse_args(words)


def test_every_command_has_examples_of_its_own():
    for name in commands():
        assert any(shlex.split(line)[1] == name for line in examples(name)), name
        assert name in RUNS, f"say in RUNS which example of {name} runs"


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_an_example_of_every_command_runs(name, bench, monkeypatch, capsys):
    if isinstance(RUNS[name], str):
        pytest.skip(RUNS[name])
    if name == "study":
        pytest.importorskip("cryptography")
    part, quick = RUNS[name]
    line = next(line for line in examples(name) if part in line)
    monkeypatch.chdir(bench)
    words = shlex.split(f"{line} {quick}")[1:]
    renamed = Renamed(bench)
    with watched(bench, renamed):
        assert main(words) == 0
    growing = ("log", "newest.csv") if name == "live" else ()  # a row is whole or missing
    assert not renamed.written_in_place(growing)  # nothing that a kill could leave cut off
    for flag, file in pairwise(words):
        if flag in ("--out", "--html"):
            assert Path(file).exists()
    assert "Traceback" not in capsys.readouterr().err
