"""Advice on parameters that a calibration leaves uncertain, and statistics of residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando.calibration.rig.model import ROWS
from glissando.calibration.rig.refine import RigFit
from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.shape import body_readings
from glissando.geometry.se3 import Array
from glissando.solver.measurement_factors import states_at

_UNLIKELY = 4.0  # standard deviations from the prior mean
_LEARNED = 0.5  # posterior over prior standard deviation above which a parameter is uncertain
_CLOCKS = PARAMETERS.index("tracker delay"), PARAMETERS.index("slide delay")

_GROUPS: dict[str, tuple[slice, str]] = {
    "the tracker's position": (slice(0, 3), "bend the robot: on a straight one all axes agree"),
    "the tracker's rotation": (
        slice(3, 6),
        "bend the robot, so that the coil's axis points in different directions",
    ),
    "the mount's offset": (
        slice(6, 8),
        "bend the robot to and fro in both planes: where cross-sections keep their direction, an "
        "offset in them looks like one of the tracker",
    ),
    "the mount's tilt": (
        slice(8, 10),
        "bend the robot to and fro in both planes: where cross-sections keep their direction, a "
        "tilt in them looks like a turn of the tracker",
    ),
    "the slide's zero": (
        slice(10, 11),
        "bend the robot to and fro in both planes: a shift along a shape that keeps still looks "
        "like a motion of the tracker",
    ),
    "the lead scale": (slice(11, 12), "slide the coil, over as much of the stroke as there is"),
    "the backlash": (
        slice(12, 13),
        "let the slide rest wherever it turns, as record --slide calibrate does: while it moves "
        "at one speed, play looks like a late clock",
    ),
    "the tracker's delay": (
        slice(13, 14),
        "move the robot to and fro: while it keeps still its shape is the same at any time",
    ),
    "the tracker's clock rate": (slice(14, 15), "record for some minutes, moving all along"),
    "the slide's delay": (slice(15, 16), "move the robot, and slide the coil, to and fro"),
    "the slide's clock rate": (slice(16, 17), "record for some minutes, sliding all along"),
}


@dataclass(frozen=True)
class StreamFit:
    """Statistics of a stream's residuals.

    Attributes:
        name: Name of the stream.
        count: Number of readings.
        rms: RMS of the residuals [m, rad].
        whitened: RMS of whitened values, about 1 if the stated noise is true: innovations per block
            for the coil; residuals for a body, which are smaller because they are of the fit.
    """

    name: str
    count: int
    rms: Array
    whitened: float


def stream_fits(fit: RigFit) -> tuple[StreamFit, ...]:
    """Residual statistics of the coil and of every body."""
    model = fit.model
    residual = replace(model, block_size=1).residual(fit.rig).reshape(-1, ROWS)
    whitened = float(np.sqrt(np.mean(fit.innovations() ** 2)))
    out = [StreamFit(model.data.coil_name, len(residual), _rms(residual), whitened)]
    shape = model.shape
    for readings in body_readings(model.data):
        at = states_at(shape.prior, shape.grid, shape.state, readings.arclength, readings.time)
        residual = readings.residual(at)
        whitened = float(np.sqrt(np.mean(residual**2 / readings.cov.diagonal())))
        out.append(StreamFit(readings.name, len(residual), _rms(residual), whitened))
    return tuple(out)


def _rms(residual: Array) -> Array:
    return np.sqrt([np.mean(residual[:, :3] ** 2), np.mean(residual[:, 3:] ** 2)])


def advice(data: RigData, cov: Array, std: Array) -> tuple[str, ...]:
    """Sentences on each group of parameters whose posterior is little better than the prior.

    Args:
        data: The session.
        cov: Posterior covariance (17, 17).
        std: Prior standard deviations (17,).

    Returns:
        A sentence for each group that is uncertain in any direction, with a motion that makes it
        observable.
    """
    sentences, names = [], []
    for name, (at, motion) in _GROUPS.items():
        before = std[at]
        if not np.all(before > 0.0):
            continue
        share = cov[at, at] / np.outer(before, before)
        if np.sqrt(np.linalg.eigvalsh(share)[-1]) <= _LEARNED:
            continue
        names.append(name)
        if data.bodies or name in ("the lead scale", "the slide's delay"):
            after = np.sqrt(cov.diagonal()[at]).max()
            sentences.append(
                f"{name[0].upper()}{name[1:]} is known little better than before (±{after:.2g} of "
                f"±{before.max():.2g}): {motion}."
            )
    if data.bodies and "the tracker's delay" in names and data.slides:
        difference = np.zeros(len(PARAMETERS))
        difference[list(_CLOCKS)] = -1.0, 1.0
        after = float(np.sqrt(difference @ cov @ difference))
        if after < _LEARNED * std[_CLOCKS[0]]:
            sentences.append(
                f"How far the clocks of slide and tracker are apart is known to {1e3 * after:.2g} "
                f"ms all the same."
            )
    return tuple(sentences)


def prior_conflicts(rig: Rig, expected: Rig, std: Array) -> tuple[str, ...]:
    """Sentences on constants of slide and clocks that lie far from their prior mean.

    Args:
        rig: Calibrated rig.
        expected: Prior mean.
        std: Prior standard deviations (17,).
    """
    deviation, sentences = rig.minus(expected), []
    for name, (at, _) in _GROUPS.items():
        k = at.start
        if at.stop - k == 1 and std[k] > 0.0 and abs(deviation[k]) > _UNLIKELY * std[k]:
            sentences.append(
                f"{name[0].upper()}{name[1:]} was found {abs(deviation[k]) / std[k]:.0f} standard "
                f"deviations (±{std[k]:.2g}) from what was expected: state how large it may be, "
                f"or do not trust this result; what else was found may be off as far."
            )
    return tuple(sentences)
