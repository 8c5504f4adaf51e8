"""What acts on a robot, from the command line: printed, in query.csv and in posterior.nc."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from glissando import estimate, load_recording
from glissando.calibration.robot.hyperparameters import expanded, learnable, moved
from glissando.cli.main import main
from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.netcdf import load_posterior, save_posterior, to_xarray
from glissando.io.query_csv import LOAD_COLUMNS
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot, parse_robot
from glissando.io.toml_table import Table
from glissando.simulation import Loads, Rod, Wrench, solve_shape

ROBOT = """
name = "rod"
length = 0.5
rest_strain = [0, 0, 1, 0, 0, 0]

[grid]
arclength_nodes = 6
time_rate = 4.0

[base]
var_pose = [1e-10, 1e-10]

[mechanics]
tubes = [{ outer = 1.2e-3 }]
young = 60e9
poisson = 0.33
density = 6450
gravity = [0, 0, -9.81]

[prior]
kind = "mechanical"
time_scale = 1.0
psd_load = [1e-6, 1e-10]
psd_strain_error = [1e-10, 1e-6]
var_tip = [0.04, 1e-6]
points = [0.3]
var_points = [[0.04, 1e-6]]

[sensors.coil]
std = [0.7e-3, 7e-3]
"""
FORCE = np.array([0.05, 0.02, 0.0])
STD = np.repeat([0.7e-3, 7e-3], [3, 2])


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A second of a coil's readings of a rod that is pushed at its tip."""
    folder = tmp_path_factory.mktemp("pushed")
    robot = folder.parent / "rod.toml"
    robot.write_text(ROBOT)
    rod = Rod.of_tubes(0.5, [(1.2e-3, 0.0)], young=60e9, poisson=0.33, density=6450.0)
    push = Loads(gravity=[0, 0, -9.81], wrenches=[Wrench(0.5, FORCE)])
    time = np.arange(0.0, 1.01, 0.1)
    place = 0.5 - 0.3 * np.abs(np.sin(3.0 * time))
    off = np.zeros((time.size, 6))
    off[:, :5] = np.random.default_rng(0).standard_normal((time.size, 5)) * STD
    pose = solve_shape(rod, [], push).at(place).pose @ se3.exp(off)
    write_streams(
        folder, "pushed", [Stream("coil", Rows("coil", time, place, pose, {}))], robot=robot
    )
    return folder


def test_a_robot_file_of_a_mechanical_prior_is_read_and_written(recording):
    robot = load_robot(recording / "robot.toml")
    assert robot.prior.kind == "mechanical"
    assert 0.3 in np.round(robot.arclength_nodes, 9)
    table = robot.prior.to_table()
    assert json.loads(json.dumps(table)) == table


def test_loads_are_printed_answered_and_saved(recording, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("points.csv").write_text("time,arclength\n0.5,0.25\n0.7,0.31\n")
    options = ["--loads", "--json", "--query", "points.csv"]
    assert main(["estimate", str(recording), *options]) == 0
    rows = json.loads(capsys.readouterr().out)["loads"]
    at_tip = rows[-1]
    assert at_tip["arclength"] == 0.5
    std = np.array(at_tip["std"][:3])
    assert np.all(np.abs(at_tip["force"] - FORCE) < 4.0 * std)
    assert std.min() < 0.06
    answers = np.genfromtxt("query.csv", delimiter=",", names=True)
    assert answers.dtype.names[-12:] == tuple(LOAD_COLUMNS)

    robot = load_robot(recording / "robot.toml")
    readings, _ = load_recording(recording).readings(["coil"], robot, (0.0, 1.0))
    posterior = estimate(robot.prior, robot.grid(0.0, 1.0), readings)
    wrench = posterior.wrench([0.25, 0.31], [0.5, 0.7])
    found = np.stack([answers[name] for name in LOAD_COLUMNS], axis=1)
    np.testing.assert_allclose(found[:, :6], wrench.wrench, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found[:, 6:], wrench.std, rtol=1e-4)
    save_posterior(posterior, "posterior.nc")
    again = load_posterior("posterior.nc").wrench([0.25, 0.31], [0.5, 0.7])
    np.testing.assert_allclose(again.wrench, wrench.wrench, atol=1e-12)
    data = to_xarray(posterior)
    assert data["load"].dims == ("time", "place", "component6")
    assert data["load"].attrs == {"units": "N, N m", "frame": "body"}
    np.testing.assert_allclose(data["place"], [0.3, 0.5])
    np.testing.assert_allclose(data["wrench"][:, -1], data["load"][:, -1], atol=1e-9)


def test_a_robot_of_unknown_mechanics_is_one_sentence(recording, capsys):
    assert main(["estimate", str(recording), "--robot", "tdcr466", "--loads"]) == 2
    assert "what the robot is made of" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("label", "field"),
    [
        ("load, linear", "psd_load"),
        ("strain error, angular", "psd_strain_error"),
        ("tip, linear", "var_tip"),
        ("points 1, linear", "var_points"),
    ],
)
def test_loads_can_be_learned(label, field):
    document = expanded(tomllib.loads(ROBOT))
    (parameter,) = (p for p in learnable(document, []) if p.label == label)
    doubled = moved(document, [parameter], np.log([2.0]))
    was, now = (
        parse_robot(Table(each, "rod", GlissandoError)).prior for each in (document, doubled)
    )
    for name in ("psd_load", "psd_strain_error", "var_tip", "var_points"):
        ratio = np.ravel(getattr(now, name) / getattr(was, name))
        half = slice(3, 6) if label.endswith("angular") else slice(0, 3)
        expected = np.ones(6)
        expected[half] += name == field
        np.testing.assert_allclose(ratio, expected)
