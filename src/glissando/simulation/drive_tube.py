"""Stick-slip motion of the coil at the end of an elastic drive tube.

The tube is a spring between motor and coil. The coil has mass, viscous and dry friction in the
outer tube, and sticks until the spring force exceeds the breakaway force. Source: Karnopp 1985.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import expm

from glissando.geometry.se3 import Array

STEP = 2.5e-4
"""Time step of the integration, s."""


@dataclass(frozen=True)
class DriveTube:
    """A drive tube with the coil at its end.

    Attributes:
        stiffness: Stiffness between motor and coil, N/m; zero for a rigid tube.
        mass: Moving mass of coil and tube, kg.
        damping: Viscous friction of the coil, N s/m.
        friction: Dry friction of the sliding coil, N.
        stiction: Ratio of the breakaway force to the friction of sliding.
    """

    stiffness: float
    mass: float
    damping: float
    friction: float
    stiction: float

    def follow(self, motor: Array, step: float = STEP) -> Array:
        """Displacements (M,) of the coil for displacements (M,) of the motor every `step` seconds.

        The coil starts at rest with an unstrained tube. During a step it sticks, or slides in one
        direction as a linear oscillator, integrated exactly for a motor of constant speed.
        """
        if self.stiffness <= 0.0:
            return np.array(motor)
        (p0, p1, p2, p3, p4), (v0, v1, v2, v3, v4) = self._transition(step).tolist()
        place, speed, direction = float(motor[0]), 0.0, 0.0
        coil, moves = [place], pairwise(motor.tolist())
        for before, after in moves:
            if (
                direction == 0.0
                and abs(self.stiffness * (after - place)) > self.stiction * self.friction
            ):
                direction = 1.0 if after > place else -1.0
            if direction != 0.0:
                rate = (after - before) / step
                place, speed = (
                    p0 * place + p1 * speed + p2 * before + p3 * rate + p4 * direction,
                    v0 * place + v1 * speed + v2 * before + v3 * rate + v4 * direction,
                )
                if speed * direction <= 0.0:
                    force = self.stiffness * (after - place)
                    speed, sticks = 0.0, abs(force) <= self.stiction * self.friction
                    direction = 0.0 if sticks else float(np.sign(force))
            coil.append(place)
        return np.array(coil)

    def _transition(self, step: float) -> Array:
        """Transition matrix (2, 5) of a step to the coil's displacement and speed.

        Columns are displacement and speed of the coil, of the motor, and the direction of sliding.
        """
        k, c, m = self.stiffness, self.damping, self.mass
        rate = np.zeros((5, 5))
        rate[0, 1] = rate[2, 3] = 1.0
        rate[1] = np.array([-k, -c, k, 0.0, -self.friction]) / m
        flow: Array = expm(rate * step)[:2]
        return flow
