"""A coil at the tip of an arc, as an online estimator reads it."""

import numpy as np

from glissando import CoilReadings
from glissando.geometry import se3

COV = np.array([5e-7] * 3 + [2e-5] * 3)


def tip(length, bend, plane):
    """Pose (4, 4) of the tip of an arc."""
    return se3.exp(length * np.array([0, 0, 1, bend * np.cos(plane), bend * np.sin(plane), 0]))


def coil(rng, time, pose, length):
    noise = np.sqrt(COV[:5]) * rng.standard_normal(5)
    seen = pose @ se3.exp(np.append(noise, 0.0))
    return CoilReadings(
        time=np.full(1, time),
        arclength=np.full(1, length),
        values=seen[None],
        cov=COV[:5],
        name="coil",
    )
