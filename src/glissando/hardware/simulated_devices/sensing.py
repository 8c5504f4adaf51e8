"""What a simulated tracker measures of a scene's coils, frame by frame."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.simulated_devices.scene import Scene
from glissando.hardware.simulated_devices.travel import Travel
from glissando.simulation.imperfections import SmoothField
from glissando.simulation.tracker import error_twists, rolled


class Sensing:
    """The frames of a tracker: frame `index` is measured at `born` + index / `rate` s.

    Args:
        scene: The robot and its coils.
        travel: Where the slide's travel comes from, if anywhere.
        born: When the device was switched on, s of time.monotonic().
        epoch: When the scene begins, by the same clock.
        rate: Frames a second.
    """

    def __init__(self, scene: Scene, travel: Travel | None, born: float, epoch: float, rate: float):
        self._scene, self._travel = scene, travel
        self._born, self._epoch, self._rate = born, epoch, rate
        rng = np.random.default_rng([scene.seed, 0])
        self._bias = SmoothField.draw(rng, 3, 5, scene.flaws.bias_length)
        self._roll = rng.bit_generator.seed_seq.spawn(1)[0]  # type: ignore[attr-defined]
        self.values = lru_cache(64)(self._values)

    def _values(self, index: int) -> Array:
        """Values (C, 8) of a frame: quaternion [w, x, y, z], position in mm, quality."""
        scene, moment = self._scene, self._born + index / self._rate
        travel = self._travel.at(moment) if self._travel else 0.0
        rng = np.random.default_rng([scene.seed, 1, index])
        pose = scene.T_wt @ scene.coil_poses(moment - self._epoch, travel)
        noise = rng.standard_normal((len(pose), 5))
        pose = pose @ se3.exp(error_twists(noise, self._bias, pose, scene.flaws))
        pose = se3.inverse(scene.T_wt) @ pose
        pose = rolled(pose, scene.flaws.roll, np.random.default_rng(self._roll))
        quality = rng.uniform(0.02, 0.2, (len(pose), 1))
        return np.hstack([se3.quaternion(pose[:, :3, :3]), 1e3 * pose[:, :3, 3], quality])
