"""What tests of the online estimator share: priors, and readings that come as live ones do."""

from dataclasses import replace

import numpy as np

import separable_sessions as drawn
from glissando import load_robot

PRIORS = {
    "kinematic": load_robot("tdcr466").prior,
    "separable": replace(drawn.PRIOR, time_scale=0.5),
}


def fed(smoother, grid, readings):
    """The smoother after all readings came as they would live; the newest of every update."""
    newest = []
    for k, time in enumerate(grid.time):
        since = grid.time[k - 1] if k else -np.inf
        for stream in readings:
            now = stream.select((stream.time > since) & (stream.time <= time))
            if len(now):
                smoother.add(now)
        newest.append(smoother.advance(time))
    return newest
