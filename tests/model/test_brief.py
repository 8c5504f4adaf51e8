"""What a session shows of an object is a few lines, with the sizes of what it holds."""

import numpy as np
import pytest

from glissando import CoilReadings, PoseReadings, load_robot
from glissando.evaluation.run import run_estimate
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording import Recording


def things():
    robot = load_robot("tdcr466")
    time, place = np.linspace(0, 0.2, 5), np.full(5, robot.length)
    tip = np.tile(np.eye(4), (5, 1, 1))
    tip[:, 2, 3] = robot.length
    rows = Rows("pose", time, place, tip, {"repeated": 3})
    stream = Stream("tip", rows, std=np.full(6, 1e-3))
    recording = Recording("bench", "there", {"tip": stream, "mid": stream}, robot, None)
    run = run_estimate(recording, robot, window=None, use=["tip"], truth=["mid"])
    state = run.posterior.at([0.1, 0.2], [0.1, 0.1])
    return [robot, robot.grid(0, 1), rows, stream, recording, run, run.posterior, state,
            run.readings[0], run.errors[0]]  # fmt: skip


def test_objects_show_themselves_in_a_few_lines():
    for thing in things():
        shown = repr(thing)
        assert shown.startswith(type(thing).__name__ + "(")
        assert len(shown) < 800, shown
        assert "array([" not in shown


def test_sizes_and_ends_of_arrays_are_shown():
    time = np.linspace(0.0, 2.0, 50)
    seen = PoseReadings(
        time=time, arclength=np.full(50, 0.4), values=np.tile(np.eye(4), (50, 1, 1)), cov=1e-6
    )
    assert "time=<array (50,), 0 … 2>" in repr(seen)
    assert "values=<array (50, 4, 4)>" in repr(seen)
    assert repr(seen).startswith("PoseReadings(")


@pytest.mark.parametrize("kind", [PoseReadings, CoilReadings])
def test_a_sensor_of_ones_own_is_brief_as_well(kind):
    class Own(kind):
        pass

    own = Own(time=np.zeros(9), arclength=np.zeros(9), values=np.tile(np.eye(4), (9, 1, 1)), cov=1)
    assert repr(own).startswith(("Own(", "test_"))
    assert len(repr(own)) < 600
