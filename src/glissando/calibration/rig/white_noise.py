"""How noisy a coil's readings are: by how much each differs from what its neighbours say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.model import ROWS, CoilModel
from glissando.calibration.rig.rig import Rig

_WITHIN = 2.0  # usual steps between three readings that count as neighbours
_NORMAL = 1.4826  # standard deviations of a normal number in its median distance from zero
_FEWEST = 20  # triples of neighbours


def with_measured_noise(model: CoilModel, rig: Rig) -> CoilModel:
    """The model with white noise of the coil as large as readings show, or as was assumed.

    Second differences of the residuals of neighbours show the white noise alone: what a rough rig,
    a field's distortion or a tube's clearance add changes slowly.

    Args:
        model: The readings, none averaged.
        rig: A rough rig.
    """
    step = np.diff(model.data.coil_time)
    residual = replace(model, block_size=1).residual(rig).reshape(-1, ROWS)
    if len(residual) < 3:
        return model
    near = np.maximum(step[1:], step[:-1]) < _WITHIN * np.median(step)
    second = (residual[2:] - 2.0 * residual[1:-1] + residual[:-2])[near] / np.sqrt(6.0)
    if len(second) < _FEWEST:
        return model
    spread = _NORMAL * np.median(np.abs(second), axis=0)
    seen = np.sqrt([np.mean(spread[:3] ** 2), np.mean(spread[3:] ** 2)])
    noise = replace(model.data.noise, coil=np.maximum(model.data.noise.coil, seen))
    return replace(model, data=replace(model.data, noise=noise))
