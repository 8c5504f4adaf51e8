"""The description of a robot before any reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import OutsideGridError
from glissando.geometry.se3 import Array
from glissando.model.field_checks import FieldChecks, is_number
from glissando.model.grid import SAME, Grid
from glissando.model.mechanics import Mechanics
from glissando.model.memory import require_memory
from glissando.model.noise import Loss
from glissando.model.priors.prior import Prior
from glissando.model.priors.white_noise import BaseDensity
from glissando.model.seconds import seconds
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.short_repr import ShortRepr
from glissando.model.state import DOF
from glissando.model.tendons.tendons import Tendons
from glissando.model.tube import Tube

SHORTEST, LONGEST = 1e-3, 50.0  # admissible lengths of a robot, m
_BLOCKS = 4.0  # dense square blocks that an estimate stores for each time node


@dataclass(frozen=True)
class Robot(ShortRepr):
    """A robot before any reading: its length, grid, prior and sensors.

    Attributes:
        name: Name of the robot.
        length: Length, m.
        arclength_nodes: Arclength nodes (N,), m.
        time_rate: Time nodes a second.
        prior: Gaussian prior of its shape and motion.
        sensor_std: Standard deviations by kind of sensor.
        sensor_loss: Robust loss by kind of sensor.
        sensor_range: Largest value that a kind of sensor can report, SI units.
        sensor_rate: Measurement rate, 1/s, by kind of tracker that is polled faster than this.
        sensor_parameters: Frames, mounts, offsets and biases of streams by name.
        mechanics: Stiffness, mass and tool; None if not given.
        tube: Whole-body tube of guaranteed coverage; None if not calibrated.
        tendons: Tendons; None if not given.
        nodes_at_readings: Whether readings that share a time step get time nodes of their own.
        file: File from which the robot was read, if any.
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
    nodes_at_readings: bool = False
    file: Path | None = None

    def __post_init__(self) -> None:
        stated = FieldChecks(self)
        if not isinstance(self.name, str):
            raise stated.fail("name", f"is {self.name!r}; give a text, and then the length.")
        length = stated.number("length", above=0.0)
        if not SHORTEST <= length <= LONGEST:
            raise stated.fail("length", f"is {length:g} m; give metres, not millimetres or inches.")
        nodes = stated.numbers("arclength_nodes", (-1,))
        if np.any(np.diff(nodes) <= 0.0) or nodes[0] != 0.0 or abs(nodes[-1] - length) > SAME:
            raise stated.fail(
                "arclength_nodes",
                f"go from {nodes[0]:g} to {nodes[-1]:g} m; let them increase from 0 to the "
                f"length, {length:g} m.",
            )
        stated.number("time_rate", above=0.0)
        if isinstance(self.prior, type) or not hasattr(self.prior, "rest_state"):
            raise stated.fail("prior", f"is {self.prior!r}; give a Prior.")
        std = {kind: _std(stated, kind, given) for kind, given in self.sensor_std.items()}
        object.__setattr__(self, "sensor_std", std)

    def stated_transform(self, kind: str, stream: str) -> Array:
        """Logarithm (6,) of the given frame or mount of a stream; zeros if none is given."""
        stated = (p for p in self.sensor_parameters if p.kind == kind and stream in p.streams)
        return next((parameter.value for parameter in stated), np.zeros(6))

    def grid(self, start: float, stop: float, readings: Sequence[Readings] = ()) -> Grid:
        """Grid of the robot over a time window.

        Args:
            start: First time, s.
            stop: Last time, s.
            readings: Readings to add time nodes at, if the robot has `nodes_at_readings`.

        Raises:
            OutsideGridError: The times are not numbers in order, or an estimate would need more
                memory than the machine has.
        """
        if not (is_number(start) and is_number(stop) and start <= stop):
            raise OutsideGridError(
                f"A grid goes from {start!r} to {stop!r} s; give two numbers, the later one second."
            )
        wanted = max(2.0, float(np.round((stop - start) * self.time_rate)) + 1.0)
        self._require_memory(wanted, start, stop, f"at {self.time_rate:g} nodes a second")
        grid = Grid(self.arclength_nodes, np.linspace(start, stop, int(wanted)))
        if not (self.nodes_at_readings and readings):
            return grid
        grid = grid.with_nodes_at(np.concatenate([r.time for r in readings]))
        self._require_memory(grid.time.size, start, stop, "with nodes_at_readings")
        return grid

    def _require_memory(self, count: float, start: float, stop: float, how: str) -> None:
        require_memory(
            self.memory(count),
            f"{seconds(start, stop)} s {how} would be {count:,.0f} time nodes",
            "choose a shorter window or a lower time_rate",
        )

    def memory(self, count: float) -> float:
        """Approximate memory, in bytes, of an estimate over `count` time nodes.

        Args:
            count: Number of time nodes.
        """
        return float(count) * _BLOCKS * 8.0 * (DOF * self.arclength_nodes.size) ** 2


def _std(stated: FieldChecks, kind: str, given: ArrayLike) -> Array:
    """Checked standard deviations of a kind of sensor; a pair [linear, angular] is expanded."""
    try:
        std = np.atleast_1d(np.array(given, dtype=float))
    except (TypeError, ValueError):
        std = np.zeros(0)
    if std.ndim != 1 or not std.size or not np.all((std > 0.0) & np.isfinite(std)):
        raise stated.fail("sensor_std", f"of {kind} is {given!r}; give numbers above 0.")
    rows = SENSORS[kind].rows if kind in SENSORS else std.size
    return np.repeat(std, (3, rows - 3)) if std.size == 2 and rows in (5, 6) else std


def base_std(prior: Prior, time_rate: float) -> float:
    """Standard deviation of the position of a robot's base, m; 0 if not stated.

    Args:
        prior: Prior of the robot's motion.
        time_rate: Time nodes a second, by which a density over time becomes a variance.
    """
    base = getattr(prior, "base", None)
    var = getattr(prior, "var_base", np.zeros(3)) if base is None else base.pose
    nodes = time_rate if isinstance(base, BaseDensity) else 1.0
    return float(np.sqrt(nodes * np.sum(var[:3])))
