"""Files of every version that ever landed are read, with the numbers of the code that wrote them.

The folder golden holds a file for each version of each format and for each way it was written.
Posteriors, recordings, sessions, journals and robot files were made by the code of their time,
which also printed the numbers beside them (NAME.json) after reading its own file.
"""

import json
import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from glissando import load_posterior, load_recording, load_robot, save_posterior
from glissando.errors import GlissandoError, OldNameWarning
from glissando.io.journal import Journal
from glissando.io.provenance import FORMATS, require_readable, stated_format
from glissando.io.session_log import read_session
from glissando.model.state import State

GOLDEN = Path(__file__).parent / "golden"
PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def files(kind):
    found = sorted(GOLDEN.joinpath(kind).glob("*.json"))
    assert found, kind
    return [pytest.param(file, id=file.stem) for file in found]


def summary(recording):
    """What a recording's numbers come to, as their first reader printed it."""
    streams = {}
    for name, stream in recording.streams.items():
        rows = stream.rows
        streams[name] = {"kind": rows.kind, "truth": stream.truth, "rows": len(rows.time)}
        for key, values in (("time", rows.time), ("arclength", rows.arclength)):
            streams[name][key] = pytest.approx(float(np.sum(values)), rel=1e-12)
        streams[name]["values"] = pytest.approx(float(np.sum(np.abs(rows.values))), rel=1e-9)
    return {"name": recording.name, "streams": streams}


@pytest.mark.slow
@pytest.mark.parametrize("file", files("posterior"))
def test_a_posterior_of_any_version_answers_as_it_did(file, tmp_path):
    pytest.importorskip("h5netcdf")
    wanted = json.loads(file.read_text())
    # All priors but the white-noise one bridged intervals from the earlier time node alone then,
    # and at first a lasting base had no bridge of its own.
    tolerance = 1e-7 if file.stem == "1-plain" else 5e-3
    posterior = load_posterior(file.with_suffix(".nc"))
    save_posterior(posterior, tmp_path / "again.nc")
    for answers in (posterior, load_posterior(tmp_path / "again.nc")):
        at = answers.at(arclength=[0.1, 0.3, 0.4], time=[0.02, 0.05, 0.1])
        assert answers.solve.converged
        first_order = np.sqrt(np.trace(at.cov[..., :3, :3], axis1=-2, axis2=-1))  # as was stated
        for name, values in wanted.items():
            found = first_order if name == "std_position" else getattr(at, name)
            np.testing.assert_allclose(
                found, values, rtol=tolerance, atol=tolerance * np.abs(values).max()
            )


@pytest.mark.parametrize("file", [*files("recording"), *files("journal"), *files("session")])
def test_a_recording_a_journal_and_a_session_of_any_version_have_the_rows_they_had(file):
    assert summary(load_recording(file.with_suffix(""))) == json.loads(file.read_text())


@pytest.mark.parametrize("file", files("session"))
def test_a_log_of_any_version_holds_the_recording_that_was_made_of_it(file):
    pytest.importorskip("mcap")
    log = load_recording(file.with_suffix("") / "session.mcap")
    written = load_recording(file.with_suffix(""))
    assert list(log.streams) == list(written.streams)
    for name, stream in written.streams.items():
        rows = log.streams[name].rows
        np.testing.assert_allclose(rows.time, stream.rows.time, atol=1e-9)
        np.testing.assert_allclose(rows.values, stream.rows.values, atol=1e-9)


def test_a_journal_of_any_version_ends_where_it_was_killed_and_goes_on(tmp_path):
    for file in sorted(GOLDEN.joinpath("journal").glob("*.json")):
        folder = shutil.copytree(file.with_suffix(""), tmp_path / file.stem)
        Journal(folder).close()
        assert summary(load_recording(folder)) == json.loads(file.read_text())


@pytest.mark.filterwarnings("ignore::glissando.errors.OldNameWarning")
@pytest.mark.parametrize("file", files("robot"))
def test_a_robot_file_of_any_version_is_the_robot_it_was(file):
    wanted = json.loads(file.read_text())
    robot = load_robot(file.with_suffix(".toml"))
    for key in ("name", "length", "time_rate"):
        assert getattr(robot, key) == wanted[key]
    np.testing.assert_allclose(robot.arclength_nodes, wanted["arclength_nodes"], atol=1e-12)
    assert {k: v.tolist() for k, v in sorted(robot.sensor_std.items())} == wanted["std"]
    assert [parameter.name for parameter in robot.sensor_parameters] == wanted["parameters"]


def test_every_version_of_every_format_has_a_golden_file():
    journal = {"journal": FORMATS["recording"]}
    for kind, newest in ({**FORMATS, **journal}).items():
        if kind != "calibration":  # tests/calibration/test_calibration_files.py writes and reads it
            numbers = {
                int(file.stem.split("-")[0]) for file in GOLDEN.joinpath(kind).glob("*.json")
            }
            assert numbers == set(range(1, newest + 1)), kind


def test_what_is_written_states_the_newest_version_and_the_page_describes_it():
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(GOLDEN / "posterior" / "2-mechanical.nc", engine="h5netcdf") as file:
        assert file.attrs["format"] == stated_format("posterior")
        assert json.loads(file.attrs["versions"])["glissando"]
    for kind in ("recording", "journal"):
        text = (GOLDEN / kind / "1-stated" / "recording.toml").read_text()
        assert text.startswith(f'format = "{stated_format("recording")}"\nmade_by = "glissando ')
    assert f'format = "{stated_format("robot")}"' in (GOLDEN / "robot/1-stated.toml").read_text()
    for kind in FORMATS:
        assert f"`{stated_format(kind)}`" in PAGE, kind
    for field in fields(State):
        assert f"`{field.name}`" in PAGE, field.name


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_of_a_version_to_come_is_refused_with_a_remedy(kind):
    require_readable(None, kind, "a file")
    for number in range(1, FORMATS[kind] + 1):
        require_readable(f"glissando {kind} {number}", kind, "a file")
    with pytest.raises(GlissandoError, match=r"later version wrote.*Install a newer"):
        require_readable(f"glissando {kind} {FORMATS[kind] + 1}", kind, "a file")
    for other in ("glissando film 1", 7, f"glissando {kind}", f"glissando {kind} 0"):
        with pytest.raises(GlissandoError, match=f"is not a glissando {kind}"):
            require_readable(other, kind, "a file")


def test_every_reader_refuses_a_file_of_a_version_to_come(tmp_path):
    pytest.importorskip("mcap")
    text = (GOLDEN / "robot" / "1-stated.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace("glissando robot 1", "glissando robot 9"))
    with pytest.raises(GlissandoError, match="later version wrote"):
        load_robot(tmp_path / "robot.toml")
    folder = shutil.copytree(GOLDEN / "recording" / "1-stated", tmp_path / "recording")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("recording 1", "recording 9"))
    with pytest.raises(GlissandoError, match="later version wrote"):
        load_recording(folder)
    log = (GOLDEN / "session" / "1-one-stage" / "session.mcap").read_bytes()
    assert read_session(GOLDEN / "session/1-one-stage/session.mcap").metadata["format"]
    (tmp_path / "later.mcap").write_bytes(
        re.sub(b"glissando session 1", b"glissando session 9", log)
    )
    with pytest.raises(GlissandoError, match="later version wrote"):
        load_recording(tmp_path / "later.mcap")


def test_old_names_in_a_robot_file_are_read_with_a_warning():
    with pytest.warns(OldNameWarning, match=r"\[\[unknowns\]\] is now"):
        load_robot(GOLDEN / "robot" / "1-unknowns.toml")
