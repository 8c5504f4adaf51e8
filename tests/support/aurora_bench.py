"""A scene whose poses state their own time, for a simulated Aurora."""

import time
from contextlib import contextmanager

import numpy as np

from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.simulation.imperfections import Imperfections

SPEED = 0.02  # m/s at which everything moves along the tracker's x
QUIET = Imperfections(roll="minimal").without("jitter", "bias")


def tell_tale(flaws=QUIET, seed=7, coils=None):
    """A straight robot along z that moves along x: x / SPEED is the scene's time."""
    lasts, length = 400.0, 0.1
    T_wb = np.tile(np.eye(4), (2, 2, 1, 1))
    T_wb[1, :, 0, 3], T_wb[:, 1, 2, 3] = SPEED * lasts, length
    if coils is None:
        coils = (SceneCoil(length, 0.0, np.eye(4), 0), SceneCoil(0.05, -1.0, np.eye(4), 1))
    ends = np.array([0.0, lasts]), np.array([0.0, length])
    return Scene(*ends, T_wb, np.eye(4), tuple(coils), flaws, seed)


@contextmanager
def simulated(folder, *options, scene=None):
    """A simulated Aurora of the tell-tale scene; its address, and when the scene began."""
    file = folder / "scene.npz"
    (tell_tale() if scene is None else scene).save(file)
    epoch = time.monotonic()
    where = () if {"--tcp", "--pty"} & set(options) else ("--tcp", "0")
    with started("aurora", "--scene", file, "--epoch", f"{epoch}", *where, *options) as address:
        yield address, epoch


def measured_time(pose, epoch):
    """When a pose of the tell-tale scene was measured, by its position."""
    return epoch + pose[0, 3] / SPEED
