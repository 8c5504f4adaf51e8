"""An estimate that leaves and comes back as somebody else's is judged as it was."""

import json

import numpy as np
import pytest

from glissando import (
    CoilReadings,
    GlissandoError,
    OrientationReadings,
    PoseReadings,
    estimate,
    load_robot,
)
from glissando.cli.main import main
from glissando.errors import ImplausibleError, SensorError
from glissando.evaluation.foreign_estimate import (
    ForeignEstimate,
    estimate_of_tracks,
    foreign_report,
    read_estimate,
)
from glissando.evaluation.metrics import errors_against
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.foreign import export, read_tracks
from glissando.io.recording import Recording
from glissando.io.recording_folder import save_recording
from glissando.visualization.page.comparison import comparison, written_runs

PLACES = np.array([0.0, 0.1, 0.233, 0.35, 0.466])


@pytest.fixture(scope="module")
def scene():
    robot = load_robot("tdcr466")
    rng = np.random.default_rng(2)
    time = np.linspace(0.0, 0.3, 13)
    tip = np.tile(np.eye(4), (13, 1, 1))
    tip[:, 2, 3] = robot.length
    tip[:, 0, 3] = 0.02 * np.sin(9 * time)
    seen = robot_readings("coil", time, robot.length, tip, 2e-3)
    posterior = estimate(robot.prior, robot.grid(0.0, 0.3), [seen])
    streams = {}
    for place in (0.233, 0.466):
        truth = posterior.at(np.full(13, place), time).pose.copy()
        truth[:, :3, 3] += 2e-3 * rng.standard_normal((13, 3))
        rows = Rows("pose", time, np.full(13, place), truth, {})
        streams[f"at_{1e3 * place:.0f}"] = Stream(f"at_{1e3 * place:.0f}", rows, True,
                                                  np.full(6, 1e-4), keep_repeats=True)  # fmt: skip
    return robot, posterior, Recording("bench", None, streams, robot, None)


def robot_readings(name, time, place, values, std):
    return PoseReadings(
        time=time, arclength=np.full(time.size, place), values=values, cov=std**2, name=name
    )


def test_its_errors_and_their_nees_come_back(scene, tmp_path):
    robot, posterior, recording = scene
    export(posterior, tmp_path / "all.csv", arclength=PLACES, rate=40.0)
    theirs = read_estimate(tmp_path / "all.csv")
    for truth in recording.readings(["at_233", "at_466"], robot, (0.0, 0.3), as_truth=True)[0]:
        mine, its = errors_against(posterior, truth), theirs.errors(truth)
        np.testing.assert_allclose(its.position, mine.position, atol=1e-6)
        np.testing.assert_allclose(its.rotation, mine.rotation, atol=1e-6)
        np.testing.assert_allclose(its.nees_position, mine.nees_position, rtol=1e-3)


def test_positions_alone_and_trajectories_have_errors_without_confidence(scene, tmp_path):
    robot, posterior, recording = scene
    (truth,) = recording.readings(["at_466"], robot, (0.0, 0.3), as_truth=True)[0]
    mine = errors_against(posterior, truth)
    at = posterior.at(np.full(13, 0.466), truth.time).position
    lines = [
        f"{t!r};0.466;{x!r};{y!r};{z!r}"
        for t, (x, y, z) in zip(truth.time.tolist(), at.tolist(), strict=True)
    ]
    (tmp_path / "p.csv").write_text(
        "time;arclength;x;y;z\n" + "\n".join(lines).replace(".", ",") + "\n"
    )
    its = read_estimate(tmp_path / "p.csv").errors(truth)
    np.testing.assert_allclose(its.position, mine.position, atol=1e-9)
    assert np.all(np.isnan(its.rotation))
    export(posterior, tmp_path / "tip.txt", rate=40.0)
    said = "time=1,x=2,y=3,z=4,qx=5,qy=6,qz=7,qw=8"
    tracks = read_tracks(tmp_path / "tip.txt", columns=said)
    its = estimate_of_tracks(tracks, {"tip": 0.466}).errors(truth)
    np.testing.assert_allclose(its.position, mine.position, atol=1e-6)
    np.testing.assert_allclose(its.rotation, mine.rotation, atol=1e-6)
    with pytest.raises(GlissandoError, match="hold no 'top'; they hold tip"):
        estimate_of_tracks(tracks, {"tip": 0.466, "top": 0.1})
    with pytest.raises(GlissandoError, match="Say where on the robot the trajectories tip are"):
        estimate_of_tracks(tracks, {})


def test_between_arclengths_and_times_a_steady_motion_is_exact(tmp_path):
    lines = ["time,arclength,x,y,z"]
    lines += [f"{t},{s},{t * s},{2 * s},{s - t}" for t in (0, 1, 2) for s in (0, 0.2, 0.5)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    theirs = read_estimate(tmp_path / "a.csv")
    rng = np.random.default_rng(0)
    s, t = rng.uniform(0, 0.5, 50), rng.uniform(0, 2, 50)
    at = theirs.at(s, t).position
    np.testing.assert_allclose(at[:, 1:], np.stack([2 * s, s - t], axis=1), atol=1e-12)
    assert theirs.covers(np.array([0.1, 0.6, 0.1]), np.array([1.0, 1.0, 2.1])).tolist() == [
        *(True, False, False)
    ]


def test_an_estimate_without_a_rotation_is_refused(tmp_path):
    text = "time,arclength,x,y,z,qw,qx,qy,qz\n0,0.1,0,0,0.1,0,0,0,0\n"
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(GlissandoError, match="a quaternion has norm 0; check which columns"):
        read_estimate(tmp_path / "a.csv")


def test_nothing_is_judged_in_gaps_or_outside_and_that_is_counted(scene):
    robot, posterior, recording = scene
    truth = recording.readings(["at_233", "at_466"], robot, (0.0, 0.3), as_truth=True)[0]
    time = np.r_[np.arange(0.0, 0.1, 0.005), np.arange(0.2, 0.26, 0.005)]
    theirs = ForeignEstimate(
        np.array([0.4, 0.466]),
        [time] * 2,
        [posterior.at(np.full(time.size, s), time).pose for s in (0.4, 0.466)],
        [np.full((time.size, 6, 6), np.nan)] * 2,
        turns=True,
    )
    report = foreign_report("theirs", theirs, recording, robot, truth)
    assert report["dropped"] == {
        "at_233": {"outside the estimate": 13},
        "at_466": {"outside the estimate": 2, "in gaps of the estimate": 4},
    }
    assert [(s["name"], s["samples"]) for s in report["sites"]] == [("at_466", 7)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "sentence"),
    [
        ((1.0, 1.0, 1e3), "not on the robot.*millimetres"),
        ((1e3, 1.0, 1.0), "times are probably in milliseconds"),
        ((1.0, 1e3, 1.0), "goes to arclength 466 m, and robot 'tdcr466' is 0.466 m long"),
    ],
)
def test_an_estimate_in_other_units_is_refused(scene, factors, sentence):
    robot, posterior, recording = scene
    truth = recording.readings(["at_466"], robot, (0.0, 0.3), as_truth=True)[0]
    time = np.linspace(0.0, 0.3, 31)
    poses = [posterior.at(np.full(31, s), time).pose * 1.0 for s in PLACES]
    for pose in poses:
        pose[:, :3, 3] *= factors[2]
    none = [np.full((31, 6, 6), np.nan)] * 5
    theirs = ForeignEstimate(factors[1] * PLACES, [factors[0] * time] * 5, poses, none, turns=True)
    with pytest.raises(ImplausibleError, match=sentence):
        foreign_report("theirs", theirs, recording, robot, truth)


def test_the_command_makes_a_run_that_a_report_shows(scene, tmp_path, capsys):
    _, posterior, recording = scene
    save_recording(recording, tmp_path / "bench", "tdcr466")
    export(posterior, tmp_path / "theirs.csv", arclength=PLACES, rate=40.0)
    call = ["import", str(tmp_path / "theirs.csv"), "--estimate", str(tmp_path / "bench")]
    assert main([*call, "--out", str(tmp_path / "run")]) == 0
    assert "mm RMSE against at_233, at_466." in capsys.readouterr().out
    assert main([*call, "--out", str(tmp_path / "run")]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert {s["name"] for s in report["sites"]} == {"at_233", "at_466"}
    assert report["overall"]["position_rmse"] == pytest.approx(2e-3 * 3**0.5, rel=0.4)
    page = comparison(written_runs([tmp_path / "run"]))
    assert "imported from theirs.csv" in page


def test_it_is_judged_by_orientations_too():
    time, turn = np.linspace(0.0, 1.0, 11), np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    pose, cov = np.tile(np.eye(4), (11, 1, 1)), np.tile(1e-4 * np.eye(6), (11, 1, 1))
    theirs = ForeignEstimate(np.array([0.2]), [time], [pose], [cov], True)
    mount = se3.exp(np.array([0.01, 0.0, 0.0, 0.0, 0.3, 0.0]))
    values = np.tile((se3.exp(turn) @ mount)[:3, :3], (11, 1, 1))
    place = np.full(11, 0.2)
    truth = OrientationReadings(
        time=time, arclength=place, values=values, mount=mount, cov=[1e-6] * 3, name="imu"
    )
    np.testing.assert_allclose(theirs.errors(truth).rotation, 0.1, atol=1e-9)


def swaying(time):
    """Strains (M, 6) of an arc that sways by half a turn a metre."""
    return np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) + np.outer(np.cos(time), [0, 0, 0, np.pi, 0, 0])


def bent_estimate(places, time):
    """Trajectories at some places of an arc that sways, with rotations."""
    pose = [se3.exp(place * swaying(time)) for place in places]
    cov = [np.full((time.size, 6, 6), np.nan)] * len(places)
    return ForeignEstimate(np.array(places), [time] * len(places), pose, cov, turns=True)


def test_between_places_a_body_is_an_arc_and_far_apart_it_is_not_judged():
    time = np.linspace(0.0, 1.0, 21)
    theirs = bent_estimate([0.1, 0.2, 0.3, 0.4, 0.5], time)
    truth = robot_readings("there", time, 0.25, se3.exp(0.25 * swaying(time)), np.full(6, 1e-3))
    np.testing.assert_allclose(theirs.errors(truth).position, 0.0, atol=1e-9)
    assert not theirs.dropped(truth)
    sparse = bent_estimate([0.1, 0.5], time)
    assert sparse.dropped(truth) == {"in gaps of the estimate": 21}
    assert not len(sparse.errors(truth).position)


@pytest.mark.parametrize("turns", [True, False])
def test_an_estimate_that_is_right_has_the_errors_of_the_truth_alone(turns):
    """Whatever the mount, and whatever the axes in which the truth's noise is stated."""
    rng, count = np.random.default_rng(3), 400
    time = np.linspace(0.0, 1.0, count)
    pose = se3.exp(rng.normal(0.0, 0.5, (count, 6)))
    shown = pose.copy()
    if not turns:
        shown[:, :3, :3] = np.eye(3)
    none = np.tile(1e-12 * np.eye(6), (count, 1, 1))
    theirs = ForeignEstimate(np.array([0.2]), [time], [shown], [none], turns)
    mount = se3.exp(np.array([3e-3, 0.0, 0.0, 0.0, 0.5 * np.pi, 0.0]))
    std = np.array([1e-3, 1e-3, 1e-2, 1e-3, 1e-3, 1e-3])
    fields = {"time": time, "arclength": np.full(count, 0.2), "mount": mount, "name": "truth"}
    noisy = pose @ mount @ se3.exp(std * rng.standard_normal((count, 6)))
    errors = theirs.errors(PoseReadings(values=noisy, cov=std**2, **fields))
    assert np.mean(errors.nees_position / 3.0) == pytest.approx(1.0, abs=0.2)
    rolled = np.zeros((count, 6))
    rolled[:, 5] = rng.uniform(-3.0, 3.0, count)
    coil = CoilReadings(values=pose @ mount @ se3.exp(rolled), cov=std[:5] ** 2, **fields)
    if turns:
        exact = theirs.errors(coil)
        np.testing.assert_allclose(exact.position, 0.0, atol=1e-9)
        np.testing.assert_allclose(exact.rotation, 0.0, atol=1e-9)
        return
    with pytest.raises(SensorError, match="sits beside the backbone"):
        theirs.errors(coil)
