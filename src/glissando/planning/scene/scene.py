"""Scenes: obstacles around a robot, targets of its tip, limits of its actuators.

Lengths are in metres, times in seconds, positions in the world frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.scene.obstacles import Obstacle
from glissando.planning.sliding_sensor import SlidingSensor


@dataclass(frozen=True)
class Target:
    """A point that the tip should reach: position (3,), m, tolerance, m, and time, s."""

    position: Array
    tolerance: float
    time: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", np.asarray(self.position, dtype=float))


@dataclass(frozen=True)
class SpaceZone:
    """A region of space or a part of the body where positions should be known accurately.

    Attributes:
        center: Centre (3,) of a ball in space, m; None for a part of the body.
        radius: Radius of the ball, m.
        arclength: Lower and upper end of a part of the body, m; None for a ball.
        weight: Weight relative to other zones.
    """

    center: Array | None = None
    radius: float = 0.0
    arclength: tuple[float, float] | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.center is not None:
            object.__setattr__(self, "center", np.asarray(self.center, dtype=float))


@dataclass(frozen=True)
class Actuator:
    """Limits of one actuator's position, m, speed, m/s, acceleration, m/s², and its start, m."""

    lower: float
    upper: float
    speed: float
    acceleration: float
    start: float


@dataclass(frozen=True)
class Weights:
    """Weights of the cost terms of a motion; targets and risk are constraints.

    Attributes:
        accuracy: Weight of the tip's variance at each target over the squared tolerance.
        time: Weight of the mean square distance from the next target over that at the start.
        wear: Weight of the mean square speed of all actuators over their limits.
        information: Weight of the variance in the zones over the square of the robot's radius.
    """

    accuracy: float = 0.0
    time: float = 1.0
    wear: float = 0.1
    information: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Obstacles around a robot, targets of its tip, and limits of its actuators.

    Attributes:
        obstacles: Solids that the robot must not touch.
        targets: Points that the tip should reach, in the order of time.
        robot_radius: Radius of the body, m.
        delta: Largest allowed probability that any part of the body hits an obstacle at any time.
        horizon: Duration of the motion, s.
        tendons: Limits of each tendon's displacement.
        slides: Limits of each slide; lower and upper are arclengths of its first coil.
        sensors: Sensor on each slide.
        zones: Zones where positions should be known accurately.
        weights: Weights of the cost terms.
        model_std: Standard deviation of an error common to all clearances, besides the model
            error, m, as if the robot were thicker or thinner.
        correction: Time between two corrections of the commands by readings, s.
        reserve: Share of the tendons' speed that a plan reserves for corrections.
        stroke_reserve: Part at both ends of the tendons' strokes reserved for corrections, m.
    """

    obstacles: Sequence[Obstacle]
    targets: Sequence[Target]
    robot_radius: float
    delta: float
    horizon: float
    tendons: Sequence[Actuator]
    slides: Sequence[Actuator] = ()
    sensors: Sequence[SlidingSensor] = ()
    zones: Sequence[SpaceZone] = ()
    weights: Weights = field(default_factory=Weights)
    model_std: float = 2e-4
    correction: float = 0.25
    reserve: float = 0.5
    stroke_reserve: float = 0.0
