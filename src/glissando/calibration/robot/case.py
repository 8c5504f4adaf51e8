"""What a robot file is learned from: a grid, readings and truth of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.calibration.robot.predictive import APART, in_motion
from glissando.io.recording import Recording
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings

_REST = 1.0  # s of rest that is kept before the first and after the last motion


@dataclass(frozen=True)
class RecordingCase:
    """A window of a recording.

    Attributes:
        recording: The recording.
        window: First and last time, s.
        use: Streams to use.
        predict: Truth streams to predict; none to maximise the evidence of those that are used.
    """

    recording: Recording
    window: tuple[float, float]
    use: Sequence[str]
    predict: Sequence[str] = ()

    def grid(self, robot: Robot) -> Grid:
        """The robot's grid over the window."""
        readings = self.readings(robot) if robot.nodes_at_readings else ()
        return robot.grid(*self.window, readings)

    def readings(self, robot: Robot) -> list[Readings]:
        """The streams to use, inside the window."""
        return self.recording.readings(self.use, robot, self.window)[0]

    def truth(self, robot: Robot) -> list[Readings]:
        """The streams to predict, inside the window, put right by known sensor parameters."""
        truth, _ = self.recording.readings(self.predict, robot, self.window, as_truth=True)
        return [corrected(stream, robot.sensor_parameters) for stream in truth if len(stream)]

    def while_moving(self, robot: Robot) -> RecordingCase:
        """The case without the rest before truth first moves and after it last did.

        Truth says there what its first sample says. A case without truth stays as it is, and so
        does one whose robot never moves.
        """
        later = (in_motion([t])[1:] for t in self.truth(robot))  # a first sample counts always
        moving = APART * np.unique(np.concatenate([np.zeros(0), *later]))
        if not moving.size:
            return self
        start = max(self.window[0], moving[0] - _REST)
        stop = min(self.window[1], moving[-1] + APART + _REST)
        return replace(self, window=(float(start), float(stop)))
