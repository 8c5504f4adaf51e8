"""`glissando simulate`: a folder that is estimated like a real one, or one sentence and nothing."""

import csv
import json

import numpy as np
import pytest

from command_line import run
from glissando.io.recording_folder import load_recording
from glissando.io.shipped_robots import robot_file
from glissando.model.tendons.channel import Channel


def simulate(folder, *more):
    return run("simulate", "--out", folder, *more)


def test_a_simulated_recording_is_estimated_like_a_real_one(tmp_path, capsys):
    made = tmp_path / "s"
    assert simulate(made, "--shape", "S", "--cycles", 1, "--seed", 4) == 0
    assert "Now: glissando estimate" in capsys.readouterr().out
    assert run("estimate", made, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["status"] == "converged"
    assert len(report["sites"]) == 6
    assert report["overall"]["position_rmse"] < 0.03
    assert report["overall"]["coverage95_position"] > 0.7


def test_the_coils_arclength_is_in_every_row_and_slides(tmp_path):
    assert simulate(tmp_path / "s", "--cycles", 1) == 0
    rows = csv.DictReader((tmp_path / "s" / "coil.csv").read_text().splitlines())
    place = np.array([float(row["arclength"]) for row in rows])
    assert place.max() == pytest.approx(0.7, abs=2e-4)
    assert place.min() == pytest.approx(0.64, abs=2e-4)


def test_the_same_seed_writes_the_same_folder(tmp_path):
    for name in ("a", "b", "c"):
        seed = 1 if name == "c" else 0
        simulate(tmp_path / name, "--duration", 1, "--slide", "hold", "--seed", seed)
    text = {name: (tmp_path / name / "coil.csv").read_text() for name in "abc"}
    assert text["a"] == text["b"] != text["c"]


def test_a_hold_stays_where_it_is_told_and_a_traverse_reaches_the_base(tmp_path):
    simulate(tmp_path / "hold", "--slide", "hold", "--at", 0.05, "--duration", 1)
    simulate(tmp_path / "all", "--slide", "traverse", "--shape", "straight", "--without", "all")
    held = load_recording(tmp_path / "hold").streams["coil"].rows.arclength
    assert np.allclose(held, 0.65, atol=1e-4)
    slid = load_recording(tmp_path / "all").streams["coil"].rows.arclength
    assert slid.min() < 0.01
    assert slid.max() > 0.699


def test_gravity_in_millimetres_is_refused(tmp_path, capsys):
    shape = tmp_path / "bent.toml"
    shape.write_text("tensions = [12, 24]\ngravity = [0, 0, 9810]\n")
    assert simulate(tmp_path / "s", "--shape", shape, "--slide", "hold", "--duration", 1) == 2
    assert "gravity has length 9810; give the acceleration in m/s²" in capsys.readouterr().err


def test_shapes_and_slides_come_from_files(tmp_path):
    shape, path = tmp_path / "my.toml", tmp_path / "my.csv"
    shape.write_text(
        "time = [0, 3]\ntensions = [[0, 0], [5, 0]]\ngravity = [0, 0, 0]\n"
        "[[loads]]\narclength = 0.5\nforce = [0, 0.1, 0]\n"
    )
    path.write_text("time,displacement\n0,0.01\n3,0.04\n")
    assert simulate(tmp_path / "out", "--shape", shape, "--slide", path) == 0
    coil = load_recording(tmp_path / "out").streams["coil"].rows
    assert coil.arclength[0] == pytest.approx(0.69, abs=2e-4)
    assert coil.arclength[-1] == pytest.approx(0.66, abs=2e-4)


def test_a_robot_file_of_ones_own_travels_with_the_recording(tmp_path):
    own = tmp_path / "mine.toml"
    own.write_text(robot_file("sliding700").read_text().replace('"sliding700"', '"mine"'))
    assert simulate(tmp_path / "out", "--robot", own, "--slide", "hold", "--duration", 1) == 0
    assert load_recording(tmp_path / "out").robot.name == "mine"


def changed(old, new):
    """A robot file with one line changed, as a function of a folder."""

    def write(folder):
        text = robot_file("sliding700").read_text()
        assert old in text
        (folder / "changed.toml").write_text(text.replace(old, new, 1))
        return ["--robot", folder / "changed.toml"]

    return write


def shaped(text, *more):
    def write(folder):
        (folder / "shape.toml").write_text(text)
        return ["--shape", folder / "shape.toml", *more]

    return write


@pytest.mark.parametrize(
    ("options", "status", "sentence"),
    [
        (["--shape", "Z"], 2, "no shape named 'Z'"),
        (["--slide", "jump"], 2, "no slide named 'jump'"),
        (["--stroke", "0.08"], 2, "stroke would be 0.08 m; the stage allows 0.06 m"),
        (["--speed", "0.03"], 2, "speed would be 0.03 m/s; the stage allows 0.024 m/s"),
        (["--at", "0.01"], 2, "at says nothing to the slide oscillate"),
        (["--slide", "hold", "--cycles", "2"], 2, "cycles says nothing to the slide hold"),
        (["--cycles", "1000000000"], 2, "give a whole number from 1 to"),
        (["--duration", "1e12"], 2, "session of 1e+12 s cannot be"),
        (shaped("time = [0, 1e9]\ntensions = [[0, 0], [1, 0]]"), 2, "give its times in seconds"),
        (changed("truth_arclengths = [0.1,", "truth_arclengths = [0.7,"), 2, "each place once"),
        (changed("coil_offset = 0", "coil_offset = -0.9"), 2, "off the robot"),
        (changed("poisson = 0.33", "poisson = 5"), 2, "Poisson's ratio of 5 cannot be"),
        (changed("set_curvature =", "field_size = 0\nset_curvature ="), 2, "field_size is 0"),
        (changed('kind = "white-noise"', 'kind = "foo"'), 2, "give one of white-noise"),
        (changed("set_curvature", "set_curvatur"), 2, "did you mean 'set_curvature'"),
        (["--cycles", "0"], 2, "0 cycles cannot be"),
        (["--slide", "hold", "--at", "0.2"], 2, "stroke would be 0.2 m"),
        (["--slide", "hold", "--at", "-0.1"], 2, "100 mm beyond the tip"),
        (["--duration", "-3"], 2, "session of -3 s cannot be"),
        (["--duration", "nan"], 2, "session of nan s cannot be"),
        (["--without", "noise"], 2, "'noise' is not an imperfection"),
        (["--seed", "-1"], 2, "Seed -1 cannot be"),
        (["--robot", "nobody"], 2, "no robot named 'nobody'"),
        (["--robot", "tdcr466"], 2, "has no [physics]"),
        (changed("offset = [5e-3, 0]", "offset = [9e-3, 0]"), 2, "off a disk of 0.006 m"),
        (changed("end = 0.35", "end = 0.9"), 2, "off a robot of 0.7 m"),
        (changed("young =", "yuong ="), 2, "young"),
        (changed("stroke = 0.06", "stroke = -1"), 2, "give a number above zero"),
        (changed("inner = 1.8e-3", "inner = 2.8e-3"), 2, "give outer > inner"),
        (shaped("tensions = [5]"), 2, "give 2 numbers a row"),
        (shaped("tensions = [-5, 0]"), 2, "a tendon only pulls"),
        (shaped("tensions = [5, 0]\nforce = 3"), 2, "force is not a key"),
        (shaped("tensions = [[5, 0], [6, 0]]\ntime = [2, 1]"), 2, "give times that increase"),
        (shaped("tensions = [0, 0]\n[[loads]]\narclength = 2\nforce = [1,0,0]"), 2, "off a rod"),
        (shaped("tensions = [90000, 0]"), 1, "% of these loads the rod buckles"),
        (
            shaped(
                "tensions = [0, 0]\n[[loads]]\narclength = 0.7\nforce = [0, 0, -30]",
                *("--without", "set"),
            ),
            1,
            "% of these loads the rod buckles",
        ),
    ],
)
def test_a_mistake_is_one_sentence_and_nothing_is_written(
    tmp_path, capsys, options, status, sentence
):
    given = options(tmp_path) if callable(options) else options
    before = sorted(tmp_path.iterdir())
    assert simulate(tmp_path / "out", *given) == status
    captured = capsys.readouterr()
    assert sentence in captured.err
    assert captured.err.startswith("glissando: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert sorted(tmp_path.iterdir()) == before


def test_a_still_robot_without_noise_is_estimated_from_readings_that_repeat(tmp_path, capsys):
    made = tmp_path / "still"
    simulate(made, "--slide", "hold", "--duration", 2, "--without", "all")
    capsys.readouterr()
    assert run("estimate", made, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["readings"]["coil"] == 81
    assert report["dropped"] == {}


def test_the_base_of_the_robot_file_is_where_the_simulated_robot_stands(tmp_path):
    robot = tmp_path / "raised.toml"
    text = robot_file("sliding700").read_text()
    robot.write_text(text.replace("position = [0, 0, 0]", "position = [0, 0, 1]", 1))
    options = ["--robot", robot, "--shape", "straight", "--without", "all", "--slide", "hold"]
    simulate(tmp_path / "out", *options, "--duration", 1)
    tip = load_recording(tmp_path / "out").streams["mocap_700"].rows.values[0]
    assert tip[2, 3] == pytest.approx(1.7, abs=1e-3)


def test_a_name_that_toml_must_quote_is_read_back(tmp_path):
    simulate(tmp_path / 'a "b" ∂😀', "--slide", "hold", "--duration", 1)
    assert load_recording(tmp_path / 'a "b" ∂😀').name == 'a "b" ∂😀'


def test_a_folder_that_holds_something_is_left_alone(tmp_path, capsys):
    (tmp_path / "note.txt").write_text("mine")
    assert simulate(tmp_path, "--slide", "hold", "--duration", 1) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["note.txt"]


@pytest.mark.slow
def test_a_coil_in_a_channel_is_recorded_with_it_and_estimated_live_by_it(tmp_path, capsys):
    made = tmp_path / "s"
    shape = ("--shape", "C", "--slide", "traverse", "--duration", 8)
    assert simulate(made, *shape, "--channel", "0.008,0.5", "--without", "all") == 0
    assert load_recording(made).streams["coil"].channel == Channel(0.008, 0.5)
    described = (made / "recording.toml").read_text()
    head, _, rest = described.partition("[streams.channel]")
    ignored = head + rest[rest.index("\n\n") :]
    error = {}
    for name, text in (("beside", described), ("ignored", ignored)):
        (made / "recording.toml").write_text(text)
        capsys.readouterr()
        assert run("replay", made, "--json") == 0
        error[name] = json.loads(capsys.readouterr().out)["newest"]["overall"]
    assert error["beside"]["position_rmse"] < 0.8 * error["ignored"]["position_rmse"]
    assert error["beside"]["coverage95_position"] > 0.85


@pytest.mark.parametrize("wrong", ["4,0.5", "0.004,30", "0.004,0.5,1e-3", "four"])
def test_a_channel_that_cannot_be_is_one_sentence(tmp_path, wrong, capsys):
    with pytest.raises(SystemExit):
        simulate(tmp_path / "s", "--channel", wrong)
    assert "is not a channel; give RADIUS,ANGLE" in capsys.readouterr().err
