"""Without motion capture: the slide against the tracker, by speeds that go together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.rough import driven, slide_lag, speeds
from glissando.geometry.se3 import Array

_LEAD, _DELAY = PARAMETERS.index("lead"), PARAMETERS.index("slide delay")
_NUDGE = 0.02  # s: over which the carriage's speed is differenced
_ROUNDS = 5
_ALIKE = 4.0  # neighbouring speeds share a coil reading's noise over so many of them


def against_slide(data: RigData, expected: Rig, std: Array) -> tuple[Rig, Array]:
    """The rig with direction, lead and slide delay against the tracker, and its covariance.

    Of all else the covariance is what was believed before. The robot's own motion is noise here.
    """
    cov = np.diag(std**2)
    if not data.slides or np.ptp(data.travel) < 1e-3:
        return expected, cov
    lag = slide_lag(data)
    stamps, along = speeds(data)
    gain = 1.0
    for _ in range(_ROUNDS):
        here = driven(data, stamps + lag)
        slope = (driven(data, stamps + lag + _NUDGE) - driven(data, stamps + lag - _NUDGE)) / (
            2.0 * _NUDGE
        )
        gain = float(here @ along / (here @ here))
        by = np.stack([here, gain * slope], axis=1)
        left = along - gain * here
        step = np.linalg.solve(by.T @ by, by.T @ left)
        gain, lag = gain + float(step[0]), lag + float(step[1])
    noise = _ALIKE * float(left @ left) / left.size
    which = np.ix_([_LEAD, _DELAY], [_LEAD, _DELAY])
    cov[which] = noise * np.linalg.inv(by.T @ by)
    direction = 1 if gain > 0.0 else -1
    clock = np.array([lag, 0.0])
    return replace(expected, direction=direction, lead=abs(gain), slide_clock=clock), cov
