"""What surrounds a robot, where it should go, and what its actuators may do.

Lengths are in metres, times in seconds, all in the world frame of the robot's base.
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
    """A point that the tip reaches: position (3,) m, how near m, and when at the latest s."""

    position: Array
    tolerance: float
    time: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", np.asarray(self.position, dtype=float))


@dataclass(frozen=True)
class SpaceZone:
    """A part of space or of the body whose positions should be known well.

    Attributes:
        center: Middle (3,) of a ball in space, m, if it is in space.
        radius: Its radius, m.
        arclength: Both ends of a part of the body, m, if it is along the body.
        weight: Its share beside other zones.
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
    """Limits of all paths of one actuator: m, m/s, m/s², and where it starts."""

    lower: float
    upper: float
    speed: float
    acceleration: float
    start: float


@dataclass(frozen=True)
class Weights:
    """What a motion should be good at, beside reaching its targets at the risk that is allowed.

    Attributes:
        accuracy: Variance of the tip at each target over the square of its tolerance.
        time: Mean square distance from the target on the way over that at the start.
        wear: Mean square speed of all actuators over their limits.
        information: Variance in the zones over the square of the robot's radius.
    """

    accuracy: float = 0.0
    time: float = 1.0
    wear: float = 0.1
    information: float = 0.0


@dataclass(frozen=True)
class Scene:
    """What surrounds a robot, where it should go, and what it may do.

    Attributes:
        obstacles: What must not be touched.
        targets: Where the tip should go, in the order of time.
        robot_radius: Radius of the body, m.
        delta: Largest probability that any part hits anything at any moment.
        horizon: Duration of the motion, s.
        tendons: Limits of each tendon.
        slides: Limits of each slide; lower and upper are arclengths of its first coil.
        sensors: What slides on each.
        zones: Where confidence is wanted.
        weights: What counts.
        model_std: Standard deviation of a clearance that no model error explains, m: one error of
            all places, as if the robot were thicker or thinner.
        correction: Time between two corrections of the commands by what was read, s.
        reserve: Share of the tendons' speed that a plan leaves to corrections.
        stroke_reserve: What a plan leaves to them at both ends of the tendons' strokes, m.
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
