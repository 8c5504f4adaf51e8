"""Frames, mounts and lateness found from sensors and truth together."""

from pathlib import Path

import numpy as np
import pytest

from glissando.calibration.robot.hyperparameters import expanded
from glissando.calibration.robot.joint_calibration import lasting, locate, while_moving
from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording import Recording
from glissando.io.robot_file import parse_robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.sensors import PoseReadings
from glissando.model.table import Table
from learn_drawn import shipped
from scenes import LENGTH, arc

LATE = 0.015
FRAME = np.array([2e-3, -1e-3, 1e-3, 4e-3, -3e-3, 5e-3])
MOUNTS = {"t1": [1e-3, -1e-3, 0, 0.02, 0.01, 0.03], "t2": [-1e-3, 2e-3, 0, 0, 0.03, -0.02]}
TILT = np.array([0, 0, 0, 0.05, -0.04, 0.02])
PLACES = {"base": 0.0, "tip": LENGTH, "t1": LENGTH / 2, "t2": LENGTH}
WINDOW = (0.0, 4.0)


def moving(name, time):
    return arc(np.full(time.size, PLACES[name]), 3.0 * time)


def recording():
    """The moving arc: its base, its tip by a tilted tracker, and two bodies of a late truth."""
    rng, streams = np.random.default_rng(0), {}
    for name, place in PLACES.items():
        time = np.arange(0.05, 3.95, 0.05)
        truth = name in MOUNTS
        pose = moving(name, time - LATE * truth)
        if truth:
            pose = se3.exp(-FRAME) @ pose @ se3.exp(np.array(MOUNTS[name]))
        if name == "tip":
            pose = pose @ se3.exp(TILT)
        pose = pose @ se3.exp(rng.standard_normal((time.size, 6)) * np.repeat([2e-4, 2e-3], 3))
        rows = Rows("pose", time, np.full(time.size, place), pose, {})
        streams[name] = Stream(name, rows, truth)
    return Recording("arc", Path(), streams, None, None)


@pytest.fixture(scope="module")
def found():
    document = expanded(shipped("tdcr466-segments"))
    document["sensors"]["pose"] = {"std": [2e-4] * 3 + [2e-3] * 3}  # stamps that are its own
    calm = [1e-5, 1e-5, 1e-5, 1.0, 1.0, 1.0]  # as the motion drawn here
    document["prior"] |= {"psd_strain_arclength": [calm, calm], "var_jumps": [calm]}
    document["base"] |= {"var_pose": [1e-6] * 3 + [1e-4] * 3, "var_strain": calm}
    tilt = {"name": "tip mount", "kind": "mount", "streams": ["tip"], "std": [1e-3, 0.1]}
    drift = {**tilt, "name": "drift", "std": [1e-4, 1e-3], "correlation_time": 1.0}
    late = {"name": "late", "kind": "time_offset", "streams": ["tip"], "std": [1e-3]}
    document["sensor_parameters"] = [tilt, drift, late]
    return locate(document, recording(), WINDOW, ["base", "tip"], ["t1", "t2"])


def poses(found, name, constants):
    """What a stream says of its cross-section once constants are put right."""
    robot = parse_robot(Table(found[0], "found", GlissandoError))
    stream = recording().readings([name], robot, WINDOW)[0][0]
    known = [u for u in robot.sensor_parameters if u.known]
    right = corrected(stream, [*known, *constants])
    return right.time, right.values @ se3.inverse(right.mount)


@pytest.mark.slow
def test_truth_put_right_is_where_the_robot_is(found):
    time, pose = poses(found, "t1", found[1])
    off = se3.log(se3.inverse(moving("t1", time)) @ pose)
    assert np.abs(off.mean(axis=0)[:3]).max() < 2e-3


@pytest.mark.slow
def test_truth_and_a_tilted_tracker_at_one_place_agree_once_put_right(found):
    (time, tip), (late, truth) = poses(found, "tip", ()), poses(found, "t2", found[1])
    np.testing.assert_allclose(time - late, LATE, atol=4e-3)
    moved = moving("t2", late) @ se3.inverse(moving("tip", time)) @ tip
    off = se3.log(se3.inverse(truth) @ moved).mean(axis=0)
    assert np.abs(off[:3]).max() < 1e-3
    assert np.abs(off[3:]).max() < 5e-3


@pytest.mark.slow
def test_what_belongs_to_a_recording_is_not_carried_to_the_next(found):
    document, constants, std, _ = found
    assert all(np.all(s > 0.0) for s in std.values())
    kept = {u["name"]: u for u in document["sensor_parameters"]}
    assert "std" not in kept["tip mount"]
    assert "std" in kept["drift"]
    assert "std" in kept["late"]
    assert {c.kind for c in constants} == {"frame", "mount", "time_offset"}
    assert {c.kind for c in lasting(constants)} == {"frame", "mount"}
    assert all(c.known for c in constants)


def test_truth_counts_while_any_of_it_moves():
    """Both rest for two seconds, then one moves: of both the stretches are kept that it changed."""
    time = np.arange(0.05, 3.95, 0.05)
    moves = np.where(time < 2.0, 0.0, 3.0 * (time - 2.0))
    rest, swing = (
        PoseReadings(
            time=time,
            arclength=np.full(time.size, place),
            values=arc(np.full(time.size, place), moves),
            cov=1e-6,
            name=name,
        )
        for name, place in (("low", 0.0), ("high", LENGTH))
    )
    none = rest.select(slice(0, 0))
    low, nothing, high = while_moving([rest, none, swing], [none, rest, swing])
    assert len(nothing) == 0
    for body in (low, high):
        np.testing.assert_allclose(body.time, time[(time < 0.49) | (time > 2.49)])
