"""Calibration files, sessions, and the command."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rigs_drawn as rigs
from glissando import GlissandoError, load_robot
from glissando.calibration.rig.plausible import require_metres
from glissando.calibration.rig.result import apply, load_calibration
from glissando.calibration.rig.rig import PARAMETERS, Body, RigData
from glissando.calibration.rig.session_data import rig_data
from glissando.cli.main import main
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import parse_robot
from glissando.io.session_log import read_session
from glissando.io.shipped_robots import robot_file
from glissando.model.table import Table


@pytest.mark.slow
def test_what_is_saved_comes_back_and_serves_a_robot_file(tmp_path):
    made, _, _ = rigs.calibrated(0, "bent")
    made.save(tmp_path / "rig.toml")
    again = load_calibration(tmp_path / "rig.toml")
    assert np.allclose(again.rig.minus(made.rig), 0.0, atol=1e-12)
    assert np.array_equal(again.cov, made.cov)
    assert again.rig.direction == made.rig.direction
    assert again.warnings == made.warnings
    document = tomllib.loads((tmp_path / "rig.toml").read_text())
    robot = tomllib.loads(robot_file("sliding700").read_text())
    robot["sensor_parameters"] = document["sensor_parameters"]
    known = parse_robot(Table(robot, "r", GlissandoError))
    assert all(u.known for u in known.sensor_parameters)
    assert np.allclose(se3.exp(known.sensor_parameters[0].value), made.rig.T_wt, atol=1e-9)


def test_a_calibration_file_with_a_wrong_key_is_refused_with_its_name(tmp_path):
    made, _, _ = rigs.calibrated(0, "bent")
    made.save(tmp_path / "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    wrong = [text.replace("lead = ", "laed = "), text.replace("glissando calibration 1", "some")]
    wrong.append(re.sub(r"^warnings = \[.*?\]", "warnings = 3.0", text, flags=re.M | re.S))
    wrong.append(re.sub(r"^log_odds = .*$", 'log_odds = "high"', text, flags=re.M))
    for bad in wrong:
        (tmp_path / "bad.toml").write_text(bad)
        with pytest.raises(GlissandoError, match=r"lead|format|warnings|log_odds"):
            load_calibration(tmp_path / "bad.toml")


def test_an_applied_calibration_puts_the_coil_on_the_robot_in_the_world():
    data, known = rigs.drawn(1)
    made = replace(rigs.calibrated(0, "bent")[0], rig=known)
    recording = apply(made, data, load_robot("sliding700"))
    readings, _ = recording.readings(["coil"], recording.robot, recording.span())
    truth = rigs.motion("waving", 1).at(readings[0].arclength, readings[0].time).pose
    off = truth @ known.coil_mount - readings[0].values
    assert np.sqrt(np.mean(off[:, :3, 3] ** 2)) < 5e-4
    assert recording.streams["tip"].truth


def test_a_session_log_holds_all_that_calibration_needs(tmp_path):
    data, _ = rigs.drawn(0, "bent")
    again = rig_data(read_session(rigs.write(tmp_path / "a.mcap", data)))
    kept = np.arange(len(data.coil_time))
    assert np.allclose(again.coil_time, data.coil_time[kept])  # frames that came twice count once
    assert np.allclose(again.coil, data.coil[kept], atol=1e-9)
    assert np.array_equal(again.travel, data.travel)
    for name, body in data.bodies.items():
        assert np.allclose(again.bodies[name].poses, body.poses, atol=1e-9)
        assert np.allclose(again.bodies[name].mount, body.mount, atol=1e-9)
    assert again.noise.backlash == data.noise.backlash


@pytest.mark.parametrize(
    ("without", "setup", "sentence"),
    [
        (("tracker",), {}, "no topic /tracker/NAME"),
        ((), {"bodies": {}}, "does not say where it sits"),
        ((), {"direction": 3}, "direction is 3"),
        ((), {"coil_arclength": "tip"}, "coil_arclength"),
        ((), {"coil_arclength": 700.0}, "arclength 700 m, off robot 'sliding700'"),
        ((), {"coil_bais": [4e-4, 5e-3, 0.1]}, "coil_bais is not a key of this table; did you"),
        ((), {"bodies": {"tip": {"arclength": 0.7, "positions": [0, 0, 1]}}}, "mean 'position'"),
    ],
)
def test_what_a_session_lacks_is_said(tmp_path, capsys, without, setup, sentence):
    data, _ = rigs.drawn(0, "bent")
    data = replace(data, bodies={"tip": data.bodies["tip"]})
    path = rigs.write(tmp_path / "a.mcap", data.at(np.arange(40)), without=without, setup=setup)
    assert main(["calibrate", str(path), "--out", str(tmp_path / "rig.toml")]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize("name", ["1-one-stage", "1-several-stages"])
def test_sessions_of_earlier_versions_say_nothing_unknown(name):
    log = Path(__file__).parents[1] / "io/golden/session" / name / "session.mcap"
    data = rig_data(read_session(log))
    assert data.coil_arclength == 0.7
    assert len(data.bodies) == 6
    require_metres(data, load_robot("sliding700"))


@pytest.mark.parametrize(
    ("bodies", "coil", "sentence"),
    [
        (1e3, 1.0, r"The distance of bodies '\S+' and '\S+' is .* give metres, not millimetres"),
        (1.0, 1e3, r"The way of 'coil' from its middle is .* give metres, not millimetres"),
        (1e-3, 1.0, r"Bodies of motion capture lie .* in metres, read as millimetres"),
        (1.0, 1e-3, r"Positions of 'coil' lie .* in metres, read as millimetres"),
    ],
)
def test_positions_in_another_unit_are_named_before_anything_is_fitted(bodies, coil, sentence):
    time, travel = np.linspace(0.0, 1.0, 20), np.linspace(0.0, 0.6, 20)

    def straight(place, scale):
        poses = np.tile(np.eye(4), (time.size, 1, 1))
        poses[:, 2, 3] = scale * place
        return poses

    def session(bodies, coil):
        placed = {f"b{s}": Body(s, np.eye(4), time, straight(s, bodies)) for s in (0.0, 0.3, 0.7)}
        seen = straight(0.7 - travel, coil)
        return RigData("coil", time, seen, time, travel, placed, 0.7, 5e-3)

    robot = load_robot("sliding700")
    require_metres(session(1.0, 1.0), robot)
    with pytest.raises(RecordingError, match=sentence):
        require_metres(session(bodies, coil), robot)


@pytest.mark.slow
@pytest.mark.parametrize("without", [(), ("slide",), ("mocap",), ("slide", "mocap")])
def test_the_command_calibrates_what_can_be(tmp_path, capsys, without):
    data, known = rigs.drawn(0, "bent", direction=1)
    path = rigs.write(tmp_path / "a.mcap", data.at(np.arange(0, 500, 4)), without=without)
    out = tmp_path / "rig.toml"
    assert main(["calibrate", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["values"]) == set(PARAMETERS)
    assert told["warnings"]
    assert load_calibration(out).rig.direction == known.direction == 1
    if not without:
        assert main(["calibrate", str(path), "--out", str(out)]) == 0
        assert "whitened" in capsys.readouterr().out


@pytest.mark.parametrize("given", [True, False])
def test_a_calibrated_session_takes_its_robots_file_along(tmp_path, monkeypatch, given):
    """Whether it is asked for or lies beside the session, whose estimate finds it there as well."""
    data, _ = rigs.drawn(0, "bent")
    data = replace(data, bodies={}).at(np.arange(0, 400, 4))
    (tmp_path / "bench").mkdir()
    mine = tmp_path / ("mine.toml" if given else "bench/mine.toml")
    mine.write_text(robot_file("sliding700").read_text().replace("sliding700", "mine"))
    setup = {} if given else {"robot": "mine.toml"}
    log = rigs.write(tmp_path / "bench/session.mcap", data, setup=setup)
    monkeypatch.chdir(tmp_path)
    made = ["--out", "rig.toml", "--recording", "made"] + ["--robot", "mine.toml"] * given
    assert main(["calibrate", str(log.parent), *made]) == 0
    assert (tmp_path / "made/robot.toml").read_bytes() == mine.read_bytes()
    assert load_recording(tmp_path / "made").robot.name == load_robot(mine).name
    if not given:
        assert load_recording(log).robot.name == load_robot(mine).name
