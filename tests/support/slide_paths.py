"""What holds for every path of a stage."""

import numpy as np

from glissando.simulation import SlideLimits

STAGE = SlideLimits(stroke=0.06, speed=0.024, acceleration=0.1)


def finely(path, count=20_001):
    time = np.linspace(path.time[0], path.time[-1], count)
    return time, path.at(time)


def require_within(path, stage):
    """By differences of the displacement itself, not by what the path says of its speed."""
    time, place = finely(path)
    step = time[1] - time[0]
    assert place.min() >= -1e-9
    assert place.max() <= stage.stroke + 1e-9
    speed = np.diff(place) / step
    assert np.abs(speed).max() <= stage.speed * (1 + 1e-6) + 1e-9
    assert np.abs(np.diff(speed)).max() / step <= stage.acceleration * 1.001 + 1e-12 / step**2
