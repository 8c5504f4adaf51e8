"""A robot as it is known before any reading."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.brief import Brief
from glissando.model.grid import Grid
from glissando.model.mechanics import Mechanics
from glissando.model.memory import require_memory
from glissando.model.noise import Loss
from glissando.model.priors.prior import Prior
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import DOF
from glissando.model.tendons.tendons import Tendons
from glissando.model.tube import Tube

_BLOCKS = 4.0  # square blocks of numbers that an estimate keeps for a time node


@dataclass(frozen=True)
class Robot(Brief):
    """A robot before any reading: its length, grid, prior and sensors.

    Attributes:
        name: Name of the robot.
        length: Length, m.
        arclength_nodes: Arclength nodes (N,), m.
        time_rate: Time nodes a second.
        prior: Prior of its motion.
        sensor_std: Standard deviations by kind of sensor.
        sensor_loss: Robust loss by kind of sensor.
        sensor_range: Largest value that a kind of sensor can report, SI units.
        sensor_rate: Readings a second of trackers that are polled faster than they measure.
        sensor_parameters: Frames, mounts, offsets and biases of streams by name.
        mechanics: What it is made of, where that is stated.
        tube: A whole-body tube whose coverage is promised, if one was calibrated.
        tendons: Its tendons, where they are stated.
        file: The file that it was read from, if there is one.
    """

    name: str
    length: float
    arclength_nodes: Array
    time_rate: float
    prior: Prior
    sensor_std: dict[str, Array] = field(default_factory=dict)
    sensor_loss: dict[str, Loss] = field(default_factory=dict)
    sensor_range: dict[str, float] = field(default_factory=dict)
    sensor_rate: dict[str, float] = field(default_factory=dict)
    sensor_parameters: tuple[SensorParameter, ...] = ()
    mechanics: Mechanics | None = None
    tube: Tube | None = None
    tendons: Tendons | None = None
    file: Path | None = None

    def grid(self, start: float, stop: float) -> Grid:
        """The robot's grid over the times [start, stop] in seconds.

        Raises:
            OutsideGridError: An estimate would need more memory than the machine can give.
        """
        wanted = max(2.0, float(np.round((stop - start) * self.time_rate)) + 1.0)
        require_memory(
            self.memory(wanted),
            f"{seconds(start, stop)} s at {self.time_rate:g} nodes a second would be "
            f"{wanted:,.0f} time nodes",
            "choose a shorter window or a lower time_rate",
        )
        return Grid(self.arclength_nodes, np.linspace(start, stop, int(wanted)))

    def memory(self, count: float) -> float:
        """Bytes that an estimate of so many time nodes takes, about.

        Args:
            count: Number of time nodes.
        """
        return float(count) * _BLOCKS * 8.0 * (DOF * self.arclength_nodes.size) ** 2
