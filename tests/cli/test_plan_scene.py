"""`glissando plan --scene`: the example among obstacles, its files, and mistakes in scenes."""

import json
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from glissando.cli.main import main
from glissando.io.robot_file import load_robot
from glissando.io.tendon_commands import read_tendon_commands
from glissando.visualization import scene_figure

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene"


def planned(folder, *words):
    """The exit status of a plan of the scene and robot in a folder."""
    files = ["--scene", str(folder / "scene.toml"), "--robot", str(folder / "arm.toml")]
    return main(["plan", *files, *map(str, words)])


@pytest.fixture
def folder(tmp_path):
    """A copy of the example."""
    for file in EXAMPLE.glob("*.toml"):
        shutil.copy(file, tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_example_is_planned_and_its_commands_are_such_as_predict_reads(
    folder, capsys, monkeypatch
):
    monkeypatch.setattr(scene_figure, "_FRAMES", 12)  # of a film, each of which takes long
    out = folder / "motion"
    assert planned(folder, "--out", out, "--figure", "svg", "--json", "--animate") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["risk"] <= report["delta"] + 2.0 * report["risk_std"]
    assert report["miss"] <= 0.003
    robot = load_robot(folder / "arm.toml")
    time, pulled = read_tendon_commands(folder / "motion" / "tendons.csv", robot.tendons.names)
    assert time[-1] == 10.0
    assert np.abs(pulled[0]).max() < 1e-6
    slides = (folder / "motion" / "slides.csv").read_text().splitlines()
    assert slides[0] == "time,coil"
    assert len(slides) == len(time) + 1
    assert (folder / "motion" / "plan.svg").read_text(encoding="utf-8").count("<path") > 100
    view = (folder / "motion" / "view.html").read_text(encoding="utf-8")
    assert '"solids":[{"vertices"' in view.replace(" ", "")
    written = json.loads((folder / "motion" / "plan.json").read_text())
    assert report.items() <= written.items()
    with Image.open(out / "plan.gif") as film:
        shown = [
            np.asarray(frame.convert("L"), dtype=float) for frame in ImageSequence.Iterator(film)
        ]
        assert film.info["duration"] * len(shown) == pytest.approx(10_000.0, rel=0.1)  # ms
    assert all(np.abs(a - b).max() > 50.0 for a, b in pairwise(shown))  # it moves


MISTAKES = [
    ("robot_radius = 0.005", "robot_radius = 5", "robot_radius is 5 m; give metres"),
    ("delta = 0.05", "delta = 5", "delta of the scene is 5; give a probability from 0.001"),
    ("delta = 0.05", "delta = 1e-6", "delta of the scene is 1e-06; give a probability"),
    ("delta = 0.05", "delta = 0.05\nmodel_std = 0.2", "model_std is 0.2 m on a robot of radius"),
    ("delta = 0.05", "delta = 0.05\ncorrection = 6", "correction of the scene is 6 s within a"),
    ("speed = 0.004", "speed = 0.004\nstart = 0.1", "Tendon 0 starts at 0.1 m, and its limits"),
    ("[[targets]]", "[[targets]]\ntime = 20", "time of a target is 20 s, and the motion lasts 10"),
    ("upper = 0.006", "upper = -0.002", "give a higher upper end"),
    ("[tendons]", "[weights]\ninformation = 1\n\n[tendons]", "information is 1 with 0 [[zones]]"),
    ("radius = 0.012", "radius = 4", "inside obstacle 1; give its size and place in metres"),
    ("position = [0.06, 0.02, 0.155]", "position = [0.03, 0.008, 0.185]", "mm from obstacle 1: w"),
    ("center = [0.03, 0.008, 0.185]", "center = [30, 8, 185]", "give metres, not millimetres"),
    ('kind = "sphere"', 'kind = "ball"', "give one of sphere, capsule, box, half-space, mesh"),
    ("radius = 0.012", "radios = 0.012", "radius is missing"),
    ("end = [0.085, 0.05, 0.15]", "end = [0.085, -0.05, 0.15]", "end is where it starts"),
    ("upper = 0.006", "upper = 6", "give metres of displacement, not millimetres"),
    ("speed = 0.004", "speed = 2", "speed is 2; give metres and seconds, 1 at most"),
    ("speed = 0.004", "speed = 0.004\nreserve = 50", "reserve is 50; give a share of the speed"),
    ("upper = 0.006", "upper = 0.006\nstroke_reserve = 1", "give metres, less than half of it"),
    ("reach = [0.06, 0.18]", "reach = [60, 180]", "give two arclengths on it, in metres"),
    ("[[targets]]", "[[goals]]", "[[targets]] is missing"),
    ("rounding = 0.003", "rounding = 0.03", "a rounding of half the least size at most"),
    ("position = [0.06, 0.02, 0.155]", "position = [0.3, 0, 0]", "is out of reach: within"),
]


@pytest.mark.parametrize(("right", "wrong", "sentence"), MISTAKES)
def test_a_mistake_in_a_scene_is_one_sentence(right, wrong, sentence, folder, capsys):
    scene = folder / "scene.toml"
    text = scene.read_text()
    assert right in text
    scene.write_text(text.replace(right, wrong, 1))
    assert planned(folder) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert sentence in error
    assert error.startswith("glissando: ")


def test_a_scene_and_zones_exclude_each_other_and_one_of_them_is_needed(folder, capsys):
    assert planned(folder, "--zone", "0.1:0.2") == 2
    assert "exclude each other" in capsys.readouterr().err
    assert main(["plan", "--robot", "sliding700"]) == 2
    assert "give --zone" in capsys.readouterr().err
