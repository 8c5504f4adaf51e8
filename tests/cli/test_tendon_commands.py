"""Tendons from the command line: files of servos in, a robot learned, its tip predicted."""

import json

import numpy as np
import pytest
import tomli_w
from scipy.stats import chi2

from glissando.cli import learn as learn_command
from glissando.cli.main import main
from glissando.estimation.tendon_prediction import predict_tip
from glissando.io.query_csv import QUERY_COLUMNS
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.model.tendons.statics import equilibrium
from glissando.model.tendons.tendon_rod import tendon_rod
from tendon_robot import NAMES, document, tendon_robot

TRUTH = {
    "angle": [0.05, 2.05, 4.25, 0.45, 2.65, 4.7],
    "slack": [2e-4, -1e-4, 0.0, 3e-4, 0.0, -2e-4],
    "play": 3e-4,
}


def moves(rng, rows):
    """Displacements of patterns, back and forth, m."""
    time = np.linspace(0.0, 2.0 * np.pi, 30)
    patterns = -(-rows // time.size)
    size = 2.5e-3 * rng.uniform(-1.0, 1.0, (patterns, 1, 6))
    return (np.sin(time)[:, None] * size).reshape(-1, 6)[:rows]


def servo_file(path, pulled, rng, noise=5e-4):
    """A file of servos of a robot that differs from its file, seen from a turned tracker."""
    robot = tendon_robot(**TRUTH)
    reached = robot.tendons.effective(pulled)
    pose = equilibrium(tendon_rod(robot, np.zeros(0)), displacement=reached).pose()[:, -1]
    tip = (pose @ [0.0, 0.0, 0.008, 1.0])[:, :3] * [-1.0, -1.0, 1.0] + [0.002, 0.0, 0.001]
    tip = tip + noise * rng.standard_normal(tip.shape)
    table = np.column_stack([1.7e9 + 0.5 * np.arange(len(tip)), 1e3 * pulled, 1e3 * tip])
    head = ",".join(["timestamp", *(f"{name}_mm" for name in NAMES), "tip_x", "tip_y", "tip_z"])
    np.savetxt(path, table, "%.6f", ",", header=head, comments="")
    return tip


@pytest.fixture
def start(tmp_path):
    path = tmp_path / "start.toml"
    path.write_text(tomli_w.dumps(document(play=2e-4)))
    return str(path)


@pytest.mark.slow
def test_a_robot_is_learned_from_imported_servos_and_predicts_other_moves(tmp_path, start, capsys):
    rng, out = np.random.default_rng(0), tmp_path / "learned.toml"
    pulled = moves(rng, 300)
    servo_file(tmp_path / "servo.csv", pulled, rng)
    record = ["import", str(tmp_path / "servo.csv"), "--robot", start, "--arclength", "tip=0.2"]
    assert main([*record, "--truth", "tip", "--out", str(tmp_path / "rec")]) == 0
    assert f"Now: glissando learn {tmp_path / 'rec'}" in capsys.readouterr().out
    learn = ["learn", str(tmp_path / "rec"), "--robot", start, "--out", str(out), "--json"]
    assert main(learn) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["rmse_left_out_mm"] < 1.3
    other = moves(rng, 90)
    tip = servo_file(tmp_path / "other.csv", other, rng, noise=0.0)
    assert main(["predict", "--robot", str(out), "--tendons", str(tmp_path / "other.csv"),
                 "--arclength", "0.1,0.2", "--stream", "tip",
                 "--out", str(tmp_path / "predicted")]) == 0  # fmt: skip
    stream = ["--tendons", str(tmp_path / "rec" / "tendons.csv"), "--out", str(tmp_path / "same")]
    assert main(["predict", "--robot", str(out), *stream]) == 0
    table = np.loadtxt(tmp_path / "predicted" / "query.csv", delimiter=",", skiprows=1)
    head = (tmp_path / "predicted" / "query.csv").read_text().splitlines()[0]
    assert head == ",".join(QUERY_COLUMNS)
    assert len(table) == 180
    position, cov = predict_tip(load_robot(out), other, "tip")
    marker = np.loadtxt(tmp_path / "predicted" / "marker_tip.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(marker[:, 1:4], position, atol=1e-7)
    np.testing.assert_allclose(marker[:, 4:], cov[:, *np.triu_indices(3)], rtol=1e-3)
    error = tip - position
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1e-3
    square = np.einsum("mi,mij,mj->m", error, np.linalg.inv(cov), error)
    assert np.mean(square < chi2.ppf(0.95, 3)) > 0.9
    truth = tendon_robot(**TRUTH)
    before = predict_tip(tendon_robot(), other, "tip")[0] * [-1.0, -1.0, 1.0]
    assert np.sqrt(np.mean(np.sum((tip - before) ** 2, axis=1))) > 3e-3
    learned = load_robot(out).tendons
    assert np.abs(learned.slack - truth.tendons.slack).max() < 2e-4
    assert learned.play == pytest.approx(truth.tendons.play, rel=0.4)
    np.testing.assert_allclose(learned.learned_to, pulled.max(axis=0), rtol=1e-3)
    farther = np.column_stack([np.arange(len(other)), 3.0 * other])
    names = ",".join(["time", *learned.names])
    np.savetxt(tmp_path / "far.csv", farther, "%.6f", ",", header=names, comments="")
    capsys.readouterr()
    far = ["--tendons", str(tmp_path / "far.csv"), "--out", str(tmp_path / "far")]
    assert main(["predict", "--robot", str(out), *far]) == 0
    said = capsys.readouterr().err
    assert said.count("Shapes there are less sure than they say") == 1
    assert f"{learned.names[0]}, {learned.names[1]}" in said


@pytest.mark.slow
def test_tips_in_another_unit_are_refused_and_tendons_that_pull_elsewhere_are_named(
    tmp_path, start, capsys
):
    rng, pulled = np.random.default_rng(0), moves(np.random.default_rng(0), 90)
    tip = servo_file(tmp_path / "metres.csv", pulled, rng)
    mixed = pulled * [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
    for name, table in (
        ("metres", np.column_stack([1e3 * pulled, tip])),
        ("mixed", np.column_stack([1e3 * mixed, 1e3 * tip])),
    ):
        rows = np.column_stack([1.7e9 + 0.5 * np.arange(len(tip)), table])
        head = (tmp_path / "metres.csv").read_text().splitlines()[0]
        file = tmp_path / f"{name}-servo.csv"
        np.savetxt(file, rows, "%.6f", ",", header=head, comments="")
        record = ["import", str(file), "--robot", start, "--arclength", "tip=0.2", "--truth", "tip"]
        assert main([*record, "--out", str(tmp_path / name)]) == 0
        capsys.readouterr()
        out = tmp_path / f"{name}.toml"
        status = main(["learn", str(tmp_path / name), "--robot", start, "--out", str(out)])
        said = capsys.readouterr().err
        if name == "metres":
            assert status == 2
            assert "The tip moves by" in said
            assert not out.exists()
        else:
            assert "of how far the tip moves: are tendons in the order and of the sign" in said


def test_what_predict_cannot_use_is_one_sentence(tmp_path, start, capsys):
    commands = tmp_path / "commands.csv"

    def told(text, *more):
        commands.write_text(text)
        out = str(tmp_path / "out")
        status = main(
            ["predict", "--robot", start, "--tendons", str(commands), "--out", out, *more]
        )
        assert not (tmp_path / "out").exists()
        return status, capsys.readouterr().err

    head = "time," + ",".join(NAMES) + "\n"
    both = head[:-1] + "".join(f",tendon_{j}" for j in range(6)) + "\n0"
    for text, sentence in [
        ("time,servo_0\n0,0\n", "has 2 columns and no servo_1; give time and a column for each"),
        (head + "0,0,0,0,0,0,0\n0,0,0,0,0,0,0\n", "does not follow 0 s; keep one row of a time"),
        (head + "1,0,0,0,0,0,0\n0,0,0,0,0,0,0\n", "line 3: time 0 s does not follow 1 s; sort"),
        (both + ",0" * 12 + "\n", f"has columns tendon_0 and {NAMES[0]} for the tendons; keep one"),
        (head + "0,0,0,0,0,0\n", "line 2: give a number in each of the 7 columns"),
        (head, "holds no commands"),
        (head + "0,2,0,0,0,0,0\n", "give metres, not millimetres"),
    ]:
        status, error = told(text)
        assert status == 2
        assert sentence in error
        assert error.count("\n") == 1
    status, error = told(head + "0,0,0,0,0,0,0\n", "--stream", "tail")
    assert status == 2
    assert "neither frame nor mount of a stream 'tail'" in error
    status, error = told(head + "0,0,0,0,0,0,0\n", "--arclength", "0.3")
    assert status == 2
    assert "leave a robot of 0.2 m" in error


def test_commands_that_are_probably_in_another_unit_are_named(tmp_path, start, capsys):
    commands = tmp_path / "commands.csv"
    for number, (scale, step, said) in enumerate([
        (1e-3, 1.0, ""),
        (1e-6, 1.0, "No displacement exceeds 0.002 mm, less than what they are off by"),
        (1e-3, 100.0, "Times of the commands are 100 s apart: if they are milliseconds"),
    ]):  # fmt: skip
        rows = [[k * step, *(scale * k * np.array([1, 0, -1, 0, 0, 0]))] for k in range(3)]
        text = "\n".join(",".join(f"{x:g}" for x in row) for row in rows)
        commands.write_text(f"time,{','.join(NAMES)}\n{text}\n")
        out = tmp_path / str(number)
        words = ["--robot", start, "--tendons", str(commands), "--out", str(out)]
        assert main(["predict", *words]) == 0
        error = capsys.readouterr().err
        assert said in error
        assert bool(said) == ("warning" in error)


def test_servos_need_a_robot_with_as_many_tendons(tmp_path, capsys):
    rng = np.random.default_rng(1)
    servo_file(tmp_path / "servo.csv", moves(rng, 5), rng)
    given = ["import", str(tmp_path / "servo.csv"), "--arclength", "tip=0.2"]
    assert main([*given, "--out", str(tmp_path / "rec")]) == 2
    assert "has 6 tendons, the robot 0; name a robot" in capsys.readouterr().err


def test_without_a_place_of_the_marker_nothing_is_learned_and_the_advice_is_to_give_it(
    tmp_path, start, capsys
):
    rng = np.random.default_rng(1)
    servo_file(tmp_path / "servo.csv", moves(rng, 20), rng)
    given = ["import", str(tmp_path / "servo.csv"), "--robot", start]
    assert main([*given, "--out", str(tmp_path / "rec")]) == 0
    said = capsys.readouterr().out
    assert "import again with --arclength tip=METRES" in said
    assert "glissando learn" not in said


def imported(tmp_path, start, columns, name):
    """Displacements of a recording made of servos in other columns."""
    rng = np.random.default_rng(5)
    file = tmp_path / f"{name}.csv"
    servo_file(file, moves(rng, 30), rng)
    head, *rows = [line.split(",") for line in file.read_text().splitlines()]
    order = [0, *(1 + np.array(columns)), 7, 8, 9]
    file.write_text("\n".join(",".join(np.array(row)[order]) for row in [head, *rows]))
    words = ["import", str(file), "--robot", start, "--arclength", "tip=0.2", "--truth", "tip"]
    assert main([*words, "--out", str(tmp_path / name)]) == 0
    return load_recording(tmp_path / name).streams["tendons"].rows.values


def test_servos_are_known_by_their_names_in_whatever_order_they_come(tmp_path, start, capsys):
    straight = imported(tmp_path, start, range(6), "straight")
    shuffled = imported(tmp_path, start, [4, 2, 0, 5, 1, 3], "shuffled")
    np.testing.assert_array_equal(straight, shuffled)
    other = tmp_path / "other.toml"
    other.write_text(tomli_w.dumps(document(names=[f"motor_{j}" for j in range(6)])))
    words = ["import", str(tmp_path / "straight.csv"), "--robot", str(other), "--arclength"]
    assert main([*words, "tip=0.2", "--truth", "tip", "--out", str(tmp_path / "no")]) == 2
    assert "has no column 'motor_0'" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    "more", ["--use tip", "--truth tip", "--hold-out tip", "--only slack", "--alike", "--steps 3"]
)
def test_learning_from_tendons_refuses_options_that_it_does_not_heed(tmp_path, start, capsys, more):
    imported(tmp_path, start, range(6), "rec")
    words = ["learn", str(tmp_path / "rec"), "--robot", start, "--out", str(tmp_path / "out.toml")]
    assert main([*words, *more.split()]) == 2
    assert f"{more.split()[0]} has no effect" in capsys.readouterr().err
    assert main([*words, "--window", "5000", "6000"]) == 2
    assert "the rows go from 0 to" in capsys.readouterr().err


def test_beside_other_sensors_tendons_leave_the_usual_way_of_learning_open(
    tmp_path, start, capsys, monkeypatch
):
    imported(tmp_path, start, range(6), "rec")
    described = tmp_path / "rec" / "recording.toml"
    coil = '\n[[streams]]\nname = "coil"\nkind = "coil"\nstd = [1e-3, 1e-2]\n'
    described.write_text(described.read_text() + coil)
    rows = "".join(f"{t},0.2,0,0,0.2,1,0,0,0\n" for t in range(3))
    (tmp_path / "rec" / "coil.csv").write_text("time,arclength,x,y,z,qw,qx,qy,qz\n" + rows)
    monkeypatch.setattr(learn_command, "learn_from_tendons", lambda *given: 77)
    words = ["learn", str(tmp_path / "rec"), "--robot", start, "--out", str(tmp_path / "out.toml")]
    usual = ["--use", "coil", "--only", "nonsense"]
    assert main(words) == 77
    assert main([*words, *usual]) == 2
    assert "--only 'nonsense' matches no number" in capsys.readouterr().err
    described.write_text(described.read_text().replace('"tip"', '"tip"\nfile = "tip.csv"', 1))
    described.write_text(described.read_text().replace('name = "tip"', 'name = "marker"'))
    assert main([*words, "--only", "nonsense"]) == 2
    assert "--only 'nonsense' matches no number" in capsys.readouterr().err


def test_a_tendon_has_one_name_and_one_column(tmp_path, start, capsys):
    rest = document()
    rest["tendons"]["names"] = [NAMES[0], *NAMES[:5]]
    twice = tmp_path / "twice.toml"
    twice.write_text(tomli_w.dumps(rest))
    commands = tmp_path / "commands.csv"
    head = ",".join(["time", *NAMES, f"{NAMES[2]}_mm"])
    np.savetxt(commands, np.zeros((1, 8)), delimiter=",", header=head, comments="")
    for robot, said in ((str(twice), f"two are named {NAMES[0]!r}"), (start, "for one tendon")):
        words = ["predict", "--robot", robot, "--tendons", str(commands)]
        assert main([*words, "--out", str(tmp_path / "out")]) == 2
        assert said in capsys.readouterr().err
