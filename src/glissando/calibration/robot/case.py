"""Recording windows from which a robot file is learned: grid, readings and truth."""

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

_REST = 1.0  # s of rest kept before the first and after the last motion


@dataclass(frozen=True)
class RecordingCase:
    """A window of a recording.

    Attributes:
        recording: The recording.
        window: First and last time, s.
        use: Names of the streams to estimate from.
        predict: Names of truth streams to predict; if empty, the evidence of `use` is maximised.
    """

    recording: Recording
    window: tuple[float, float]
    use: Sequence[str]
    predict: Sequence[str] = ()

    def grid(self, robot: Robot) -> Grid:
        """Grid of the robot over the window."""
        readings = self.readings(robot) if robot.nodes_at_readings else ()
        return robot.grid(*self.window, readings)

    def readings(self, robot: Robot) -> list[Readings]:
        """Readings of the streams `use` inside the window."""
        return self.recording.readings(self.use, robot, self.window)[0]

    def truth(self, robot: Robot) -> list[Readings]:
        """Truth streams inside the window, corrected by the robot's known sensor parameters."""
        truth, _ = self.recording.readings(self.predict, robot, self.window, as_truth=True)
        return [corrected(stream, robot.sensor_parameters) for stream in truth if len(stream)]

    def while_moving(self, robot: Robot) -> RecordingCase:
        """Copy without the rest before the first and after the last motion of the truth.

        Truth at rest adds no information to its first sample. A case without truth, or whose robot
        never moves, is returned unchanged.
        """
        later = (in_motion([t])[1:] for t in self.truth(robot))  # the first interval always counts
        moving = APART * np.unique(np.concatenate([np.zeros(0), *later]))
        if not moving.size:
            return self
        start = max(self.window[0], moving[0] - _REST)
        stop = min(self.window[1], moving[-1] + APART + _REST)
        return replace(self, window=(float(start), float(stop)))
