"""Robot files as documents, and noisy poses of the moving arc to learn them from."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np

from glissando.geometry import se3
from glissando.io.robot_file import read_robot_document
from glissando.io.shipped_robots import robot_file
from scenes import arc

NOISE = np.r_[2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2]


def shipped(name):
    return read_robot_document(robot_file(name))


def readings(kind, name, place, time, *, std=NOISE, cov=None, seed=0):
    """Poses of the moving arc, noisy by `std`."""
    place = np.broadcast_to(place, time.shape)
    noise = std * np.random.default_rng(seed).standard_normal((time.size, 6))
    values = arc(place, time) @ se3.exp(noise)
    cov = np.asarray(std) ** 2 if cov is None else cov
    return kind(time=time, arclength=place, values=values, cov=cov, name=name)


@contextmanager
def same_process(workers, context, prepare, arguments):
    """Stands for the pool of processes."""
    prepare(*arguments)
    yield SimpleNamespace(map=map, shutdown=lambda **_: None)
