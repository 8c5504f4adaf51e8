"""What commands write replaces nothing that was recorded, and is there whatever stdout does."""

import io
import json
import sys
from contextlib import contextmanager

import pytest

from command_line import run
from glissando.cli.console import Console
from glissando.cli.main import main

_TOML = """\
robot = "sliding700"

[[streams]]
name = "coil"
kind = "coil"
keep_repeats = true

[[streams]]
name = "mocap_700"
kind = "pose"
keep_repeats = true
truth = true
"""


@contextmanager
def kept(folder):
    """Nothing in a folder is changed, added or lost."""
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    yield
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A recording of a straight robot at rest."""
    folder = tmp_path_factory.mktemp("recordings") / "held"
    folder.mkdir()
    (folder / "recording.toml").write_text(_TOML)
    (folder / "robot.toml").write_text("# of the recording\n")
    for name in ("coil", "mocap_700"):
        rows = [f"{k / 20},0.7,0,0,0.7,1,0,0,0\n" for k in range(21)]
        (folder / f"{name}.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz\n" + "".join(rows))
    return folder


@pytest.mark.parametrize(
    "words",
    [
        "export {rec} --stream coil --out {rec}/coil.csv",
        "learn {rec} --robot sliding700 --out {rec}/coil.csv",
        "learn {rec} --robot sliding700 --out {rec}/recording.toml",
        "view {rec} --html {rec}/coil.csv",
        "report {rec} --out {rec}/coil.csv",
        "report {rec}/coil.csv --out {rec}/../held/coil.csv",
        "check {rec} --store-tube {rec}/coil.csv",
        "calibrate {rec} --out {rec}/coil.csv",
        "calibrate {rec} --out {rec}/robot.toml",
        "report {rec} --out {rec}/robot.toml",
        "view {rec} --html {rec}/robot.toml",
    ],
)
def test_what_was_recorded_is_not_replaced(held, capsys, words):
    with kept(held):
        assert run(*words.format(rec=held).split()) == 2
    assert "would replace data; give another name or folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "calibrate {rec} --out {mine}.toml",
        "learn {rec} --robot sliding700 --out {mine}.toml",
        "report {rec} --out {mine}.toml",
        "view {rec} --html {mine}.toml",
        "export {rec} --stream coil --out {mine}.txt",
        "export {rec} --stream coil --out {mine}.csv",
    ],
)
def test_a_file_that_no_such_command_wrote_is_not_replaced(held, tmp_path, capsys, words):
    for suffix in (".toml", ".txt", ".csv"):
        (tmp_path / f"mine{suffix}").write_text("my own notes\n")
    with kept(tmp_path):
        assert run(*words.format(rec=held, mine=tmp_path / "mine").split()) == 2
    assert "is there and none that this command writes" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["tum", "csv", "CSV"])
def test_what_the_same_command_wrote_is_replaced(held, tmp_path, suffix):
    out = tmp_path / f"coil.{suffix}"
    for _ in range(2):
        assert run("export", held, "--stream", "coil", "--out", out) == 0
    assert out.read_text()


def test_answers_to_a_query_replace_no_data_and_make_no_stream_of_a_recording(
    held, tmp_path, capsys, monkeypatch
):
    points = tmp_path / "points.csv"
    points.write_text("time,arclength\n0.5,0.7\n")
    (tmp_path / "query.csv").write_text("my own data\n")
    for folder, why in ((tmp_path, "none that this command writes"), (held, "is a recording")):
        monkeypatch.chdir(folder)
        with kept(folder):
            assert run("estimate", held, "--query", points) == 2
        assert why in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "estimate {rec}",
        "replay {rec}",
        "check {rec}",
        "plan --zone 0.5:0.6 --horizon 1",
        "design --zone 0.5:0.6 --horizon 1 --strokes 0.06",
        "reproduce",
        "study {study}",
    ],
)
def test_a_recording_is_no_folder_for_results(held, tmp_path, capsys, words):
    study = tmp_path / "sweep.toml"
    study.write_text("seeds = 1\n")
    with kept(held):
        assert run(*words.format(rec=held, study=study).split(), "--out", held) == 2
    assert "is a recording; give a folder for the results" in capsys.readouterr().err


def test_a_recording_of_the_public_layout_is_kept_as_any_other(held, tmp_path, capsys):
    public = tmp_path / "public"
    public.mkdir()
    head = "Sensor type,vicon\ntime,arclength,rho_x,rho_y,rho_z,phi_x,phi_y,phi_z\n"
    (public / "vicon1.csv").write_text(head + "0,0.7,0,0,0.7,0,0,0\n")
    with kept(public):
        words = ["export", held, "--stream", "coil", "--out", public / "vicon1.csv"]
        assert run(*words) == 2
        assert "would replace data; give another name or folder" in capsys.readouterr().err
        assert run("estimate", held, "--out", public) == 2
        assert "is a recording; give a folder for the results" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (". --level 1.5", "A level of 1.5 is not a probability"),
        (". --level 0.5 --block nan", "Blocks of nan s cannot be"),
        (".", "is a folder; name a file"),
        ("recording.toml/tube.toml", "recording.toml is not a folder that can be written to"),
    ],
)
def test_a_tube_that_cannot_be_stored_is_refused_before_an_estimate(
    held, monkeypatch, capsys, words, said
):
    monkeypatch.chdir(held)
    monkeypatch.setattr("glissando.cli.check.posterior_shown", None)
    assert run("check", ".", "--store-tube", *words.split()) == 2
    assert said in capsys.readouterr().err


def test_a_tube_replaces_no_other_robots_file(held, tmp_path, capsys):
    other = tmp_path / "other.toml"
    other.write_text('name = "other"\n')
    assert run("check", held, "--store-tube", other, "--block", "0.1") == 2
    assert "neither the --robot file nor one with a [tube]" in capsys.readouterr().err
    assert other.read_text() == 'name = "other"\n'


class Closed(io.StringIO):
    """A pipe that nobody reads."""

    def __init__(self, file):
        super().__init__()
        self.fileno = file.fileno

    def write(self, text):
        raise BrokenPipeError


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "report"),
    [
        ("estimate {rec}", "report.json"),
        ("estimate {rec} --json", "report.json"),
        ("replay {rec}", "replay.json"),
        ("check {rec}", "check.json"),
        ("plan --zone 0.5:0.6 --horizon 1", "plan.json"),
        ("design --zone 0.5:0.6 --horizon 1 --strokes 0.06 --rates 40 --coils 1", "design.json"),
        ("design --zone 0.5:0.6 --horizon 1 --sensor coil=1 --places 2", "design.json"),
    ],
)
def test_results_are_written_though_nobody_reads_the_table(
    held, tmp_path, monkeypatch, words, report
):
    out = tmp_path / "out"
    with (tmp_path / "stdout").open("w") as file, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", Closed(file))
        assert run(*words.format(rec=held).split(), "--out", out) == 141
    assert json.loads((out / report).read_text())["request"] == words.format(rec=held).split()


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_a_stdout_without_every_letter_spells_them_out(monkeypatch, encoding):
    shown = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", shown)
    assert (
        run("design", "--zone", "0.5:0.6", "--horizon", 1, "--sensor", "coil=1", "--places", 2) == 0
    )
    assert b"\\u03c3 (mm)" in shown.buffer.getvalue()


@pytest.mark.parametrize("out", ["link", "link/below"])
def test_a_link_that_leads_nowhere_is_refused_before_any_work(held, tmp_path, capsys, out):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    assert run("estimate", held, "--out", tmp_path / out) == 2
    assert "link is a link that leads nowhere; delete it." in capsys.readouterr().err


def test_a_lag_longer_than_a_thousand_time_nodes_is_refused(held, capsys):
    assert run("replay", held, "--lag", 1000) == 2
    assert "--lag is 1000 s; give at most 250 s, 1000 time nodes." in capsys.readouterr().err


def test_a_file_gets_whole_lines_and_a_stated_width_is_kept(monkeypatch):
    """Eighty columns are what Rich guesses where there is no terminal."""
    monkeypatch.delenv("COLUMNS", raising=False)
    out = io.StringIO()
    Console(file=out).print("word " * 60)
    assert len(out.getvalue().splitlines()) == 1
    monkeypatch.setenv("COLUMNS", "40")
    narrow = io.StringIO()
    Console(file=narrow).print("word " * 60)
    assert max(map(len, narrow.getvalue().splitlines())) <= 40


def test_an_option_of_the_whole_program_is_not_abbreviated(capsys):
    """Else it would be read, and its plugin not imported."""
    with pytest.raises(SystemExit) as ended:
        main(["--plug", "wire.py", "estimate", "bench"])
    assert ended.value.code == 2
    assert "invalid choice: 'wire.py'" in capsys.readouterr().err


def test_an_unknown_option_is_answered_with_the_usage_of_its_command(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["view", "results", "--nowhere", "f.html"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert told.startswith("usage: glissando view")
    assert "unrecognized arguments: --nowhere f.html" in told
