"""What acts on a robot, from the command line: printed, in query.csv and in posterior.nc."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from glissando import estimate, load_recording
from glissando.calibration.robot.hyperparameters import expanded, learnable, moved
from glissando.cli.loads import CONTACT_COLUMNS, loads_json, print_loads, write_contacts
from glissando.cli.main import main
from glissando.errors import GlissandoError
from glissando.estimation.contact import scan_contacts
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.labelled_posterior import to_xarray
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.io.query_csv import LOAD_COLUMNS
from glissando.io.recording_writer import write_streams
from glissando.io.robot_file import load_robot, parse_robot
from glissando.model.table import Table
from glissando.simulation import Loads, Rod, Wrench, solve_shape
from glissando.visualization.contact_figure import contact_figure

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


@pytest.mark.slow
def test_loads_are_printed_answered_and_saved(recording, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("points.csv").write_text("time,arclength\n0.5,0.25\n0.7,0.31\n")
    options = ["--loads", "--json", "--query", "points.csv"]
    assert main(["estimate", str(recording), *options]) == 0
    said = json.loads(capsys.readouterr().out)
    rows = said["loads"]
    assert said["contacts"]["false_alarms"] == 0.01
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


@pytest.mark.slow
def test_contacts_are_mapped_over_arclength_and_time(recording, tmp_path, capsys):
    """The push is where a load is expected: nothing else touches the robot, and the map says so."""
    robot = load_robot(recording / "robot.toml")
    readings, _ = load_recording(recording).readings(["coil"], robot, (0.0, 1.0))
    posterior = estimate(robot.prior, robot.grid(0.0, 1.0), readings)
    scan = scan_contacts(posterior, posterior.grid.time)
    print_loads(posterior, scan, Console())
    assert "touches the robot at none of 5 times" in " ".join(capsys.readouterr().out.split())
    contacts = loads_json(posterior, scan)["contacts"]
    assert contacts["detected"] == [False] * 5
    assert len(contacts["force"]) == len(contacts["std"]) == 5
    file, picture = write_contacts(scan, tmp_path)
    table = np.genfromtxt(file, delimiter=",", names=True)
    assert table.dtype.names == tuple(CONTACT_COLUMNS)
    np.testing.assert_allclose(table["log_evidence"], scan.log_ratio.ravel(), atol=1e-9)
    np.testing.assert_allclose(table["arclength"][: scan.arclength.size], scan.arclength)
    assert picture.stat().st_size > 10_000
    upper, lower = contact_figure(scan)
    (mesh,) = upper.collections
    np.testing.assert_allclose(mesh.get_array(), scan.log_ratio.T)
    np.testing.assert_allclose(mesh.get_coordinates()[[0, -1], 0, 1], [0.0, 500.0])
    evidence, threshold = (line.get_ydata() for line in lower.get_lines()[:2])
    np.testing.assert_allclose([evidence, threshold], [scan.evidence, scan.threshold])
    pushed = {
        "force": np.tile([0.1, 0.0, 0.0], (5, 1)),
        "cov": np.tile(1e-4 * np.eye(3), (5, 1, 1)),
    }
    print_loads(posterior, replace(scan, evidence=scan.threshold + 1.0, **pushed), Console())
    printed = " ".join(capsys.readouterr().out.split())
    assert "with (0.1 ± 0.01, 0 ± 0.01, 0 ± 0.01) N in the body frame" in printed
    assert "1.000 !" in printed
    assert "At times marked ! the table explains by expected loads" in printed
    touched = replace(scan, evidence=scan.threshold + np.where(scan.time > 0.5, 1.0, -1.0))
    (dots,) = contact_figure(touched)[0].get_lines()
    assert dots.get_xdata().size == np.sum(scan.time > 0.5)
    save_posterior(posterior, tmp_path / "posterior.nc")
    again = scan_contacts(load_posterior(tmp_path / "posterior.nc"), posterior.grid.time)
    np.testing.assert_allclose(again.log_ratio, scan.log_ratio, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(again.force, scan.force, rtol=1e-6, atol=1e-8)
    assert main(["figure", "contacts", str(tmp_path), "--out", str(tmp_path / "c.svg")]) == 0
    assert (tmp_path / "c.svg").stat().st_size > 10_000
    save_posterior(replace(posterior, linearized=None), tmp_path / "posterior.nc")
    capsys.readouterr()
    assert main(["figure", "contacts", str(tmp_path), "--out", str(tmp_path / "c.svg")]) == 2
    assert "estimate again from the recording" in capsys.readouterr().err


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
