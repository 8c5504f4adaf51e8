"""White noise of a coil, estimated from second differences of its residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.model import ROWS, CoilModel
from glissando.calibration.rig.rig import Rig

_WITHIN = 2.0  # median time steps, the longest between neighbouring readings
_NORMAL = 1.4826  # standard deviation of a normal variable over its median absolute value
_FEWEST = 20  # triples of neighbouring readings


def with_measured_noise(model: CoilModel, rig: Rig) -> CoilModel:
    """Model with the coil's white noise as measured, but not below the stated noise.

    Second differences of consecutive residuals contain white noise only: errors of a rough rig, the
    field's distortion and the tube's clearance change slowly.

    Args:
        model: The coil's readings, not averaged.
        rig: An approximate rig.
    """
    step = np.diff(model.data.coil_time)
    residual = replace(model, block_size=1).residual(rig).reshape(-1, ROWS)
    if len(residual) < 3:
        return model
    near = np.maximum(step[1:], step[:-1]) < _WITHIN * np.median(step)
    second = (residual[2:] - 2.0 * residual[1:-1] + residual[:-2])[near] / np.sqrt(6.0)
    if len(second) < _FEWEST:
        return model
    std = _NORMAL * np.median(np.abs(second), axis=0)
    measured = np.sqrt([np.mean(std[:3] ** 2), np.mean(std[3:] ** 2)])
    noise = replace(model.data.noise, coil=np.maximum(model.data.noise.coil, measured))
    return replace(model, data=replace(model.data, noise=noise))
