"""Effect of nodes and duration on confidence: a still robot with a coil at its tip, both priors.

`python benchmarks/invariance.py` prints the standard deviation of position at mid-length and
mid-recording, and its change if nodes or the duration are doubled.
"""

from dataclasses import replace

import numpy as np

from glissando import (
    BaseDensity,
    BaseVariance,
    CoilReadings,
    Grid,
    SeparablePrior,
    WhiteNoisePrior,
    estimate,
)
from glissando.geometry import se3

LENGTH, RATE, SCALE = 0.5, 40.0, 2.0
SHAPE = np.array([0.0, 0.0, 1.0, 1.5, -1.0, 0.5])
PSD = np.array([1e-5, 1e-5, 1e-5, 2.0, 2.0, 0.5])
POSE, STRAIN = np.full(6, 1e-6), np.array([1e-5, 1e-5, 1e-5, 2.0, 2.0, 0.1])
COIL_COV = [1e-6] * 3 + [1e-4] * 2
SEPARABLE = SeparablePrior(PSD, SCALE, BaseVariance(POSE, STRAIN), rest_strain=SHAPE)
KINEMATIC = WhiteNoisePrior(
    PSD,
    PSD,
    PSD,
    np.array([1e-4] * 3 + [1e-2] * 3),
    BaseDensity(POSE, STRAIN, np.array([1e-4] * 3 + [1e-2] * 3)),
    rest_strain=SHAPE,
)


def per_node(prior, grid, first):
    """Prior applied per node, as in published settings: weights do not depend on node spacing."""
    in_time = np.median(grid.time_spans) / np.median(first.time_spans)
    along = np.median(grid.arclength_spans) / np.median(first.arclength_spans)
    base = BaseDensity(*(in_time * getattr(prior.base, p) for p in ("pose", "strain", "velocity")))
    return replace(
        prior,
        psd_strain_arclength=in_time * prior.psd_strain_arclength,
        psd_velocity_arclength=in_time * prior.psd_velocity_arclength,
        psd_velocity_time=along * prior.psd_velocity_time,
        psd_strain_time=along * prior.psd_strain_time,
        base=base,
    )


def std_at_middle(prior, nodes=5, rate=RATE, duration=1.0, published=False):
    """Standard deviation of position (mm) at mid-length and mid-recording."""

    def grid(nodes, rate, duration):
        count = round(rate * duration) + 1
        return Grid(np.linspace(0.0, LENGTH, nodes), np.linspace(0.0, duration, count))

    used = grid(nodes, rate, duration)
    if published:
        prior = per_node(prior, used, grid(5, RATE, 1.0))
    time = np.arange(round(RATE * duration) + 1) / RATE
    tip = np.tile(se3.exp(LENGTH * SHAPE), (time.size, 1, 1))
    place = np.full(time.size, LENGTH)
    coil = CoilReadings(time=time, arclength=place, values=tip, cov=COIL_COV)
    return 1e3 * float(estimate(prior, used, [coil]).at(0.5 * LENGTH, 0.5 * duration).std_position)


def page():
    """Table with a row per prior."""
    changes = {
        "arclength nodes": {"nodes": 9},
        "time nodes": {"rate": 2.0 * RATE},
        "duration": {"duration": 2.0},
    }
    arms = {
        "separable": (SEPARABLE, False),
        "kinematic, densities": (KINEMATIC, False),
        "kinematic, per node as published": (KINEMATIC, True),
    }
    lines = [
        "| prior | σ (mm) |" + "".join(f" {what} × 2 |" for what in changes),
        "|---|---|---|---|---|",
    ]
    for name, (prior, published) in arms.items():
        first = std_at_middle(prior, published=published)
        cells = [
            f" {100.0 * (std_at_middle(prior, published=published, **more) / first - 1.0):+.2f} % |"
            for more in changes.values()
        ]
        lines.append(f"| {name} | {first:.2f} |" + "".join(cells))
    return "\n".join(lines)


if __name__ == "__main__":
    print(page())
