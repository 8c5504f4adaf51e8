"""Sessions of several coils: which is calibrated, where it is stated to be, and the others."""

import json
from dataclasses import replace

import numpy as np
import pytest

import rigs_drawn as rigs
from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.result import Calibration, apply, load_calibration
from glissando.calibration.rig.rig import Rig as Constants
from glissando.calibration.rig.session_data import rig_data
from glissando.cli.main import main
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.hardware.capture.setup import Coil, Rig
from glissando.io.robot_file import load_robot
from glissando.io.session_log import read_session

SLIDING, FIXED = Coil("coil", 0.7, arclength_std=0.004), Coil("mid", 0.35, slides=False)
OUTER = Coil("outer", 0.5, slide="b")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    data, _ = rigs.drawn(0, "bent", direction=-1)
    return rigs.write(tmp_path_factory.mktemp("log") / "a.mcap", data.at(np.arange(0, 500, 4)))


@pytest.fixture(scope="module")
def session(log):
    return read_session(log)


def recorded(session, *coils):
    """The session as `record` logs it of these coils, which all see the same; stage b goes back."""
    stated = json.loads(session.metadata["setup"])
    described = Rig("bench", "sliding700", coils=coils).described()
    setup = stated | described | {"bodies": stated["bodies"]}
    topics = {n: t for n, t in session.topics.items() if not n.startswith("/tracker/")}
    topics |= {f"/tracker/{coil.name}": session.topics["/tracker/coil"] for coil in coils}
    slide = session.topics["/slide"]
    back = [m | {"travel": 0.06 - m["travel"]} for m in slide.messages]
    topics["/slide/b"] = replace(slide, name="/slide/b", messages=back)
    return replace(session, topics=topics, metadata={"setup": json.dumps(setup)})


def test_of_several_coils_the_only_one_that_slides_is_calibrated(session):
    data = rig_data(recorded(session, FIXED, SLIDING))
    assert data.coil_name == "coil"
    assert (data.coil_arclength, data.coil_arclength_std) == (0.7, 0.004)
    assert data.direction == -1
    assert data.slides


def test_a_coil_that_is_named_is_calibrated_where_it_is_stated(session):
    several = recorded(session, SLIDING, FIXED, OUTER)
    fixed, outer = (rig_data(several, name) for name in ("mid", "outer"))
    assert fixed.coil_arclength == 0.35
    assert not fixed.slides
    assert outer.coil_arclength == 0.5
    first = rig_data(several, "coil")
    np.testing.assert_allclose(outer.travel, 0.06 - first.travel)


def test_a_session_of_one_coil_that_is_fixed_gives_its_place_on_the_robot(session):
    data = rig_data(recorded(session, FIXED))
    assert data.coil_name == "mid"
    made = calibrate(replace(data, bodies={}), rigs.robot(rigs.NODES))
    assert made.rig.zero == 0.35
    assert made.warnings[0].startswith("There is no slide topic of this coil")


def test_the_other_coils_come_into_the_world_with_the_calibrated_one(session):
    later = Coil("later", 0.65)
    data = rig_data(recorded(session, SLIDING, FIXED, OUTER, later), "coil")
    clocks = {"tracker_clock": np.array([0.2, 0.0]), "slide_clock": np.array([0.1, 0.0])}
    found = Constants(se3.exp(np.full(6, 0.3)), -1, 0.699, 0.0, lead=1.01, **clocks)
    made = Calibration(found, np.zeros((17, 17)), "coil", np.inf)
    streams = apply(made, data, load_robot("sliding700")).streams
    assert list(streams) == ["coil", "mid", "outer", "later", *data.bodies]
    coil, mid, outer, beside = (streams[n].rows for n in ("coil", "mid", "outer", "later"))
    np.testing.assert_allclose(mid.values, found.T_wt @ data.coil)
    np.testing.assert_allclose(mid.time, data.coil_time - 0.2)
    assert set(mid.arclength) == {0.35}
    np.testing.assert_allclose(beside.time, coil.time)
    np.testing.assert_allclose(coil.arclength - beside.arclength, 0.049, atol=1e-9)
    stage = np.interp(outer.time + 0.2, data.slide_time, 0.06 - data.travel)
    np.testing.assert_allclose(outer.arclength, 0.5 - stage, atol=1e-9)


def test_coils_that_cannot_be_told_apart_or_are_not_there_are_sentences(session, log, capsys):
    with pytest.raises(RecordingError, match="say with --coil which of coil, outer is to be"):
        rig_data(recorded(session, SLIDING, OUTER))
    given = ["calibrate", str(log), "--coil", "nonsense", "--out", str(log.with_name("rig.toml"))]
    assert main(given) == 2
    assert "no coil 'nonsense'; say with --coil which of coil is" in capsys.readouterr().err


@pytest.mark.parametrize("frame", [None, {"position": [0.3, 0.0, 0.0]}])
def test_without_motion_capture_the_coil_stays_in_the_frame_of_the_tracker(
    session, frame, tmp_path
):
    setup = json.loads(session.metadata["setup"])
    setup |= {"frame": frame} if frame else {}
    topics = {n: t for n, t in session.topics.items() if not n.startswith("/mocap/")}
    data = rig_data(replace(session, topics=topics, metadata={"setup": json.dumps(setup)}))
    made = calibrate(data, load_robot("sliding700"))
    recording = apply(made, data, load_robot("sliding700"))
    coil = recording.streams["coil"]
    assert (coil.frame, recording.unknown_frames) == (
        ("world", frozenset()) if frame else ("tracker", {"tracker"})
    )
    inside = np.isin(data.coil_time, coil.rows.time)
    off = coil.rows.values[:, :3, 3] - data.coil[inside][:, :3, 3]
    np.testing.assert_allclose(off, np.tile([0.3 if frame else 0.0, 0.0, 0.0], (off.shape[0], 1)))
    assert not any(row[0].startswith(("frame", "mount", "tracker")) for row in made.displayed())
    made.save(tmp_path / "rig.toml")
    assert load_calibration(tmp_path / "rig.toml").sensor_parameters() == ()
    assert "streams" not in (tmp_path / "rig.toml").read_text()
