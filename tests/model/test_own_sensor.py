"""A sensor of a user's own is declared once, and then recorded, configured, estimated, planned."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from glissando import FixedLagSmoother, Readings, estimate, load_robot
from glissando.errors import GlissandoError, SensorError
from glissando.io.journal import Journal
from glissando.io.recording_folder import load_recording, save_recording
from glissando.io.shipped_robots import robot_file
from glissando.model.sensors.readings import SENSORS
from glissando.planning import predict_information, sliding_sensor
from plans import KINEMATIC, LENGTH, REACH


@dataclass(frozen=True, kw_only=True)
class Range(Readings, kind="range"):
    """Distance from a beacon to the sensor."""

    rows: ClassVar[int] = 1
    columns: ClassVar = {"distance": "m"}
    settings: ClassVar = {"beacon": "m"}
    value_shape: ClassVar = (1,)
    beacon: np.ndarray

    @classmethod
    def values_at(cls, pose, beacon):
        return np.linalg.norm(pose[..., :3, 3] - beacon, axis=-1, keepdims=True)

    def residual(self, at):
        return self.values_at(at.pose @ self.mount, self.beacon) - self.values


@dataclass(frozen=True, kw_only=True)
class Height(Readings, kind="height"):
    """Height of the sensor, which a tracker reports in its own frame."""

    rows: ClassVar[int] = 1
    columns: ClassVar = {"z": "m"}
    value_shape: ClassVar = (1,)
    tracker: ClassVar[bool] = True

    @classmethod
    def in_frame(cls, values, pose):
        return values + pose[2, 3]

    @classmethod
    def values_at(cls, pose):
        return pose[:, 2, 3:]

    def residual(self, at):
        return self.values_at(at.pose @ self.mount) - self.values


BEACON = np.array([0.3, 0.0, 0.2])


OWN = {kind: SENSORS.pop(kind) for kind in ("range", "height")}  # known to this module's tests


@pytest.fixture(autouse=True)
def _own_sensors_are_known(monkeypatch):
    for kind, sensor in OWN.items():
        monkeypatch.setitem(SENSORS, kind, sensor)


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "mine.toml"
    own = "\n[sensors.range]\nstd = [2e-3]\nclip = 3.0\n[sensors.height]\nstd = [1e-3]\n"
    path.write_text(robot_file("sliding700").read_text() + own)
    return load_robot(path)


def ranges():
    time = np.linspace(0.0, 1.0, 21)
    tip = np.stack([0.02 * time, 0 * time, LENGTH - 0.01 * time], axis=-1)
    distance = np.linalg.norm(tip - BEACON, axis=-1, keepdims=True)
    at = {"time": time, "arclength": np.full(21, LENGTH)}
    return Range(**at, values=distance, cov=4e-6, beacon=BEACON, name="sonar")


def recorded(folder, robot):
    recording = load_recording(folder)
    return recording, recording.readings(["sonar"], robot, (0.0, 1.0))[0][0]


def test_an_own_sensor_goes_through_a_journal_and_a_saved_recording(tmp_path, robot):
    given = ranges()
    with Journal(tmp_path / "journal") as journal:
        journal.write(given)
    recording, read = recorded(tmp_path / "journal", robot)
    save_recording(recording, tmp_path / "saved")
    for readings in (read, recorded(tmp_path / "saved", robot)[1]):
        assert isinstance(readings, Range)
        np.testing.assert_allclose(readings.values, given.values, rtol=1e-11)
        np.testing.assert_array_equal(readings.beacon, BEACON)
        np.testing.assert_allclose(readings.cov, given.cov)
    assert (tmp_path / "saved" / "sonar.csv").read_text().startswith("time,arclength,distance\n")


def test_a_robot_file_states_an_own_sensors_noise_and_range(tmp_path, robot):
    (tmp_path / "recording.toml").write_text(
        '[[streams]]\nname = "sonar"\nkind = "range"\nlength_unit = "mm"\nbeacon = [300, 0, 200]\n'
    )
    (tmp_path / "sonar.csv").write_text("time,arclength,distance\n0,700,650\n0.5,700,2999\n")
    recording, readings = recorded(tmp_path, robot)
    np.testing.assert_allclose(readings.values, [[0.65]])
    np.testing.assert_allclose(readings.beacon, BEACON)
    np.testing.assert_allclose(readings.cov, [[4e-6]])
    assert recording.readings(["sonar"], robot, (0.0, 1.0))[1] == {"sonar": {"clipped": 1}}


def test_an_own_sensor_is_estimated_with(robot):
    fewer = estimate(robot.prior, robot.grid(0.0, 1.0), []).at(LENGTH, 1.0)
    posterior = estimate(robot.prior, robot.grid(0.0, 1.0), [ranges()])
    assert posterior.solve.converged
    assert posterior.at(LENGTH, 1.0).std_position < fewer.std_position


def test_an_own_tracker_stands_in_a_frame_and_is_truth(tmp_path):
    (tmp_path / "recording.toml").write_text(
        '[frames.table]\nposition = [0, 0, 1]\n[[streams]]\nname = "h"\nkind = "height"\n'
        'frame = "table"\ntruth = true\n'
    )
    (tmp_path / "h.csv").write_text("time,arclength,z\n0,0.1,0.2\n1,0.1,0.2\n2,0.1,0.3\n")
    recording = load_recording(tmp_path)
    rows = recording.streams["h"].rows
    np.testing.assert_allclose(rows.values, [[1.2], [1.3]])
    assert rows.dropped == {"repeated": 1}
    assert recording.choose(None, None) == ([], ["h"])


def test_an_own_sensor_is_planned_for(robot):
    planned = replace(KINEMATIC, sensor_std=robot.sensor_std)
    sensor = sliding_sensor(planned, "height", name="h")
    outlook = predict_information(planned, REACH, 1.0, sensor)
    assert outlook.sensor.readings(np.eye(4)[None], np.zeros(1), np.zeros(1)).kind == "height"


def test_a_kind_names_one_sensor_and_a_sensor_without_a_kind_is_not_recorded(tmp_path):
    with pytest.raises(SensorError, match="'range' is that of Range; give Sonar another"):
        type("Sonar", (Readings,), {}, kind="range")
    unnamed = type("Unnamed", (Range,), {})
    given = unnamed(**vars(ranges()))
    with Journal(tmp_path / "log") as journal, pytest.raises(SensorError, match="declares no kind"):
        journal.write(given)


def test_an_own_sensor_with_settings_is_planned_for_where_they_are_given(robot):
    planned = replace(KINEMATIC, sensor_std=robot.sensor_std)
    given = {"settings": {"beacon": BEACON}, "name": "sonar"}
    sensor = sliding_sensor(planned, "range", **given)
    outlook = predict_information(planned, REACH, 1.0, sensor)
    read = outlook.sensor.readings(np.eye(4)[None], np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(read.values, [[np.linalg.norm(BEACON)]])
    with pytest.raises(GlissandoError, match="A range has a beacon that is not given"):
        sliding_sensor(planned, "range")


def stated(jacobian):
    """A range sensor that states its own derivative."""

    def of(self, at):
        away = at.pose[:, :3, 3] - self.beacon
        axis = away / np.linalg.norm(away, axis=1, keepdims=True)
        slopes = np.zeros((len(self), 1, 18))
        slopes[:, 0, :3] = jacobian(axis, at)
        return slopes

    return type("Stated", (Range,), {"jacobian": of})


def distances(kind):
    tips = {"time": [0.0, 0.1], "arclength": [LENGTH] * 2, "values": [[0.5]] * 2, "cov": 1e-4}
    return kind(**tips, beacon=BEACON, name="range")


@pytest.mark.parametrize(
    ("jacobian", "fits"),
    [
        (lambda axis, at: np.einsum("mi,mij->mj", axis, at.pose[:, :3, :3]), True),
        (lambda axis, at: axis, False),
        (lambda axis, at: -np.einsum("mi,mij->mj", axis, at.pose[:, :3, :3]), False),
        (lambda axis, at: 0.0 * axis, False),
    ],
    ids=["body", "world", "sign", "none"],
)
def test_a_derivative_that_is_not_the_residuals_is_refused(jacobian, fits):
    readings = [distances(stated(jacobian))]
    smoother = FixedLagSmoother(KINEMATIC.prior, KINEMATIC.arclength_nodes)
    for use in (
        lambda: estimate(KINEMATIC.prior, KINEMATIC.grid(0.0, 0.2), readings),
        lambda: smoother.add(readings[0]),
    ):
        if fits:
            use()
        else:
            with pytest.raises(SensorError, match=r"jacobian\(at\) has .* leave jacobian out"):
                use()


def test_a_residual_that_is_rounded_says_so():
    def residual(self, at):
        return np.round(Range.residual(self, at), 2)

    rounded = type("Rounded", (Range,), {"residual": residual})
    with pytest.raises(SensorError, match="does not change with pose, strain or velocity"):
        estimate(KINEMATIC.prior, KINEMATIC.grid(0.0, 0.2), [distances(rounded)])
