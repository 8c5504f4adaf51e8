"""Robot files for robots of which little is known: they load, scale, and refuse wrong units."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import law
from glissando.cli.main import main
from glissando.errors import RobotFileError
from glissando.io.physics_template import physics_text
from glissando.io.robot_file import load_robot
from glissando.io.robot_template import RobotOutline, robot_text
from glissando.simulation import load_bench
from glissando.simulation.simulate import simulate

SENSORS = ["pose:a", "coil", "gyro:b", "strain", "fbg", "position:c"]
KNOWN = {
    "name": "mine",
    "length": 0.466,
    "segments": 2,
    "diameter": 0.012,
    "bend": math.pi,
    "sensors": ["pose:base", "pose:tip", "gyro:mid", "coil"],
}


@law
@given(
    st.floats(0.05, 10.0),
    st.integers(1, 8),
    st.floats(0.001, 0.04),
    st.floats(0.2, 6.0),
    st.floats(0.05, 50.0),
    st.lists(st.sampled_from(SENSORS), min_size=1, max_size=4, unique=True),
)
def test_every_likely_robot_has_a_file_that_loads(
    tmp_path_factory, length, segments, diameter, bend, time_scale, sensors
):
    outline = RobotOutline("mine", length, segments, diameter, bend, sensors, 0.04, time_scale)
    file = tmp_path_factory.mktemp("new") / "mine.toml"
    file.write_text(robot_text(outline), encoding="utf-8")
    robot = load_robot(file)
    assert robot.length == length
    assert np.allclose(np.diff(robot.prior.joints, prepend=0.0), length / segments, rtol=1e-6)
    # Two standard deviations of a segment's mean curvature are the largest bend over its length.
    piece = length / segments
    assert 2.0 * piece * np.sqrt(robot.prior.base.strain[3]) == pytest.approx(bend, rel=0.01)
    assert set(robot.sensor_std) == {s.partition(":")[0] for s in sensors}
    robot.prior.rest_state(robot.grid(0.0, 5.0 * time_scale))


def test_a_stream_gets_what_is_unknown_of_it(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(robot_text(RobotOutline(**KNOWN)), encoding="utf-8")
    parameters = load_robot(file).sensor_parameters
    kinds = [(p.streams[0], p.kind, np.isinf(p.correlation_time)) for p in parameters]
    assert kinds == [
        ("base", "mount", True),
        ("base", "mount", False),
        ("tip", "mount", True),
        ("tip", "mount", False),
        ("mid", "time_offset", True),
    ]


def test_names_may_have_any_letters(tmp_path):
    file, name = tmp_path / "mine.toml", 'my "é" arm'
    outline = {**KNOWN, "name": name, "sensors": [f"pose:{name}", "gyro:b[0]"]}
    file.write_text(robot_text(RobotOutline(**outline)), encoding="utf-8")
    robot = load_robot(file)
    assert robot.name == name
    assert {p.streams[0] for p in robot.sensor_parameters} == {name, "b[0]"}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"length": 466.0}, "length of 466 m is not likely; give 0.02 m to 10 m"),
        ({"length": 20.0}, "length of 20 m"),  # the shortest robot, in millimetres
        ({"length": math.nan}, "length of nan"),
        ({"diameter": 12.0}, "diameter of 12 m is not likely"),
        ({"bend": 180.0}, r"bend of 180 rad \(1.03e\+04 degrees\) is not likely"),
        ({"bend": math.radians(2.1)}, r"\(2.1 degrees\) is .* \(5 degrees\) to .* \(720 degrees\)"),
        ({"time_scale": 500.0}, "give 0.02 s to 60 s"),
        ({"sensors": []}, "without sensors"),
        ({"sensors": ["pose:a", "coil", "gyro:a"]}, "Two sensors are the stream 'a'"),
        ({"sensors": ["pose:../a"]}, "cannot be that of a file"),
        ({"time_scale": 5000.0}, "time scale of 5000 s"),
        ({"segments": 0}, "0 segments"),
        ({"length": 0.05, "diameter": 0.1}, "give both"),
        ({"sensors": ["camera"]}, "'camera' is not a kind of sensor; known: pose"),
    ],
)
def test_unlikely_numbers_are_refused_with_what_is_likely(wrong, said):
    with pytest.raises(RobotFileError, match=said):
        RobotOutline(**{**KNOWN, **wrong})


def test_the_command_writes_once_and_says_what_it_lacks(tmp_path, capsys, monkeypatch):
    out = tmp_path / "mine.toml"
    words = ["robot", "new", "--length", "0.4", "--segments", "2", "--out", str(out)]
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert main(words) == 2
    assert "needs --diameter, --bend, --sensors as well" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    answers = iter(["0.01", "90", "coil, gyro"])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    assert main(words) == 0
    robot = load_robot(out)
    assert set(robot.sensor_std) == {"coil", "gyro"}
    assert main(words) == 2
    assert "there already" in capsys.readouterr().err
    answers = iter(["wide"])
    assert main([*words[:-1], str(tmp_path / "other.toml")]) == 2
    assert "'wide' is not a number" in capsys.readouterr().err


@law
@given(st.floats(0.05, 2.0), st.integers(1, 4), st.floats(0.01, 0.05), st.floats(0.5, math.pi))
def test_a_robot_of_any_size_can_be_simulated(tmp_path_factory, length, segments, share, bend):
    outline = RobotOutline("mine", length, segments, share * length, bend, ["coil:coil"])
    file = tmp_path_factory.mktemp("new") / "mine.toml"
    file.write_text(robot_text(outline) + physics_text(outline), encoding="utf-8")
    load_robot(file)
    bench = load_bench(file)
    pulled = bench.shape("C")
    flaws = replace(bench.flaws, set_curvature=0.0)
    motion = bench.move(pulled, flaws, 0)
    pose = motion.at(np.array([0.0, length]), np.zeros(2)).pose
    turned = math.acos(np.clip(pose[0, :3, 2] @ pose[1, :3, 2], -1.0, 1.0))
    # Gravity and the friction of tendons take up to half of what the tension bends.
    wanted = min(0.5 * bend * segments, math.radians(150.0))
    assert 0.3 * wanted < turned < 1.3 * wanted


def test_a_robot_of_ones_own_is_simulated(tmp_path, capsys):
    file = tmp_path / "own.toml"
    words = "robot new --length 0.3 --segments 1 --diameter 0.006 --bend 90 --sensors coil:coil"
    assert main([*words.split(), "--physics", "--out", str(file)]) == 0
    assert "simulate --shape C --robot" in capsys.readouterr().out
    session = simulate(file, shape="straight-to-C", slide="oscillate", cycles=1)
    assert session.coil.time.size > 100
    assert np.ptp(session.coil.arclength) == pytest.approx(0.06, abs=0.002)


def test_a_robot_without_a_coil_is_not_made_to_be_simulated(tmp_path, capsys):
    """Its simulated session could not be estimated, as the file says nothing of a coil."""
    words = "robot new --length 0.3 --segments 1 --diameter 0.006 --bend 90 --sensors gyro:imu"
    assert main([*words.split(), "--physics", "--out", str(tmp_path / "own.toml")]) == 2
    assert "give coil among the sensors too" in capsys.readouterr().err
    assert not (tmp_path / "own.toml").exists()


@pytest.mark.parametrize(("bend", "status"), [("6.28", 2), ("12.566", 2), ("6", 0), ("7", 0)])
def test_a_bend_in_radians_is_refused(tmp_path, capsys, bend, status):
    outline = f"--length 0.4 --segments 2 --diameter 0.012 --sensors coil:coil --bend {bend}"
    words = ["robot", "new", *outline.split(), "--out", str(tmp_path / "r.toml")]
    assert main(words) == status
    assert ("is most likely in radians" in capsys.readouterr().err) == bool(status)
