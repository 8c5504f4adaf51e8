"""What tests of unknowns share: unknowns, and readings none of which is on a node."""

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from draws import motion
from glissando import (
    CoilReadings,
    Grid,
    GyroReadings,
    PoseReadings,
    PositionReadings,
    load_robot,
    uniform_grid,
)
from glissando.geometry import se3
from glissando.model.sensors.parameters import SIZES, SensorParameter
from scenes import LENGTH, arc

GRID = Grid([0.0, 0.1, 0.25, 0.4], [0.0, 0.1, 0.25, 0.35])
SURE = 1e-4  # chance that a true law fails, each side
TIMES = np.linspace(0.08, 0.92, 10)
SOFT = load_robot("tdcr466").prior
_SLOW = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
STEADY = replace(SOFT, **{name: 1e-4 * getattr(SOFT, name) for name in _SLOW})  # as the arc is
COARSE = uniform_grid(LENGTH, 3, 0.0, 1.0, 5.0)


def consistent(squares, dof):
    """Whether the sum of these squared errors is one of a chi-square with so many degrees."""
    low, high = chi2.ppf([SURE, 1.0 - SURE], dof)
    return low < np.sum(squares) < high


def unknown(kind, *streams, value=None, std=0.05, memory=np.inf, name=None):
    value = np.zeros(SIZES[kind]) if value is None else value
    return SensorParameter(name or kind, kind, streams, value, np.full(SIZES[kind], std), memory)


def scattered(rng, count=6):
    """Readings of four kinds, none on a node nor near one."""

    def where():
        inside = [np.sort(rng.uniform(0.05, 0.95, count)) for _ in "st"]
        cells = rng.integers(0, 3, (2, count))
        nodes = GRID.arclength, GRID.time
        s, t = (
            np.sort(n[c] + u * np.diff(n)[c]) for n, c, u in zip(nodes, cells, inside, strict=True)
        )
        return {"arclength": rng.permutation(s), "time": t}

    pose = motion(rng, Grid([0.2], np.linspace(0, 1, count))).pose[:, 0]
    mount = se3.exp(0.1 * rng.standard_normal((2, 6)))
    three, slide = rng.standard_normal((2, count, 3)), rng.uniform(-1.0, 1.0, (2, count))
    coil = {"mount": mount[1], "slide_speed": slide[0], "slide_way": slide[1]}
    return [
        PoseReadings(**where(), values=pose, cov=1e-2, name="pose", mount=mount[0]),
        CoilReadings(**where(), values=pose, cov=1e-2, name="coil", **coil),
        GyroReadings(**where(), values=three[0], cov=1e-2, name="gyro"),
        PositionReadings(**where(), values=three[1], cov=1e-2, name="point", mount=mount[0]),
    ]


def tracker(rng, name, place, std=1e-3, time=TIMES):
    place = np.broadcast_to(place, time.shape)
    noise = std * np.r_[1.0, 1.0, 1.0, 5.0, 5.0, 5.0] * rng.standard_normal((time.size, 6))
    cov = (std * np.r_[1.0, 1.0, 1.0, 5.0, 5.0, 5.0]) ** 2
    return PoseReadings(
        time=time, arclength=place, values=arc(place, time) @ se3.exp(noise), cov=cov, name=name
    )
