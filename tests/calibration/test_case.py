"""Windows of what a robot file is learned from."""

from types import SimpleNamespace

import numpy as np
import pytest

from glissando.calibration.robot.case import RecordingCase
from glissando.geometry import se3
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.sensors import PoseReadings

WINDOW = (3.0, 40.0)
ROBOT = SimpleNamespace(sensor_parameters=())


def case_of(first, last, moves=True):
    """A body that moves by a millimetre a sample from one time to another, and else rests.

    A second one, which always rests, is seen first two seconds later.
    """
    time = np.arange(*WINDOW, 0.1)
    way = np.zeros((time.size, 6))
    way[:, 0] = moves * 1e-3 * np.clip(time - first, 0.0, last - first) / 0.1
    fields = {"time": time, "arclength": np.zeros_like(time), "values": se3.exp(way)}
    body = PoseReadings(**fields, cov=np.full(6, 1e-6), name="body")

    def readings(names, robot, window, *, as_truth):
        resting = body.select(time > WINDOW[0] + 2.0).changed(name="resting")
        resting = resting.changed(values=np.broadcast_to(np.eye(4), resting.values.shape))
        inside = [r.select((r.time >= window[0]) & (r.time <= window[1])) for r in (body, resting)]
        return inside[: len(names)], []

    return RecordingCase(
        SimpleNamespace(readings=readings), WINDOW, ("sensor",), ("body", "resting")
    )


@pytest.mark.parametrize("seed", range(20))
def test_rest_is_left_out_but_a_second_and_all_motion_is_in(seed):
    first, last = np.sort(np.random.default_rng(seed).uniform(5.0, 38.0, 2))
    last += 1.0
    start, stop = case_of(first, last).while_moving(ROBOT).window
    assert WINDOW[0] <= start <= first
    assert last <= stop <= WINDOW[1]
    assert first - start < 2.0
    assert stop - last < 2.0


def test_a_robot_that_never_moves_and_one_without_truth_keep_their_windows():
    still = case_of(10.0, 20.0, moves=False)
    assert still.while_moving(ROBOT) is still
    unjudged = RecordingCase(still.recording, WINDOW, ("sensor",))
    assert unjudged.while_moving(ROBOT) is unjudged


def test_truth_is_put_right_by_what_is_known_of_its_frame():
    case = case_of(10.0, 20.0)
    value = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.3])
    frame = SensorParameter("seen from", "frame", ("body",), value, np.zeros(6))
    there, _ = case.truth(SimpleNamespace(sensor_parameters=(frame,)))
    plain, _ = case.truth(SimpleNamespace(sensor_parameters=()))
    np.testing.assert_allclose(there.values, corrected(plain, [frame]).values)
    assert np.abs(there.values - plain.values).max() > 0.01
