"""The coil at the end of its drive tube: where it is when the motor is elsewhere.

The tube is a spring with a damper between motor and coil; the coil has mass and rubs in the outer
tube, where it sticks until the spring pulls harder than it holds. Source: Karnopp 1985.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import expm

from glissando.geometry.se3 import Array

STEP = 2.5e-4
"""Time between two moments at which the coil is followed, s."""


@dataclass(frozen=True)
class DriveTube:
    """A drive tube with the coil at its end.

    Attributes:
        stiffness: Stiffness between motor and coil, N/m; zero if the coil is where the motor is.
        mass: What moves with the coil, kg.
        damping: Viscous friction of the coil, N s/m.
        friction: Friction of the coil that slides, N.
        stiction: How much larger the force is that it takes to set it off.
    """

    stiffness: float
    mass: float
    damping: float
    friction: float
    stiction: float

    def follow(self, motor: Array, step: float = STEP) -> Array:
        """Displacement (M,) of the coil for that of the motor (M,), every `step` seconds.

        The coil starts at rest with a tube that is not strained. Between two moments it sticks, or
        slides one way as a linear oscillator, whose motion is exact for a motor of constant speed.
        """
        if self.stiffness <= 0.0:
            return np.array(motor)
        (p0, p1, p2, p3, p4), (v0, v1, v2, v3, v4) = self._onwards(step).tolist()
        place, speed, way = float(motor[0]), 0.0, 0.0
        coil, moves = [place], pairwise(motor.tolist())
        for before, after in moves:
            if way == 0.0 and abs(self.stiffness * (after - place)) > self.stiction * self.friction:
                way = 1.0 if after > place else -1.0
            if way != 0.0:
                rate = (after - before) / step
                place, speed = (
                    p0 * place + p1 * speed + p2 * before + p3 * rate + p4 * way,
                    v0 * place + v1 * speed + v2 * before + v3 * rate + v4 * way,
                )
                if speed * way <= 0.0:
                    pull = self.stiffness * (after - place)
                    speed, stays = 0.0, abs(pull) <= self.stiction * self.friction
                    way = 0.0 if stays else float(np.sign(pull))
            coil.append(place)
        return np.array(coil)

    def _onwards(self, step: float) -> Array:
        """Matrix (2, 5) from [coil, its speed, motor, its speed, way] to coil and speed later."""
        k, c, m = self.stiffness, self.damping, self.mass
        rate = np.zeros((5, 5))
        rate[0, 1] = rate[2, 3] = 1.0
        rate[1] = np.array([-k, -c, k, 0.0, -self.friction]) / m
        flow: Array = expm(rate * step)[:2]
        return flow
