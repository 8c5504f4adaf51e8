"""What a calibration leaves unseen, which motion would show it, and how well each stream fits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando.calibration.rig.model import ROWS
from glissando.calibration.rig.refine import Found, innovations
from glissando.calibration.rig.rig import PARAMETERS, RigData
from glissando.calibration.rig.shape import body_readings
from glissando.geometry.se3 import Array
from glissando.solver.measurement_factors import states_at

_LEARNED = 0.5  # of what was believed before: a standard deviation that is not much smaller
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
    """How well readings fit: RMS of their residuals [m, rad], and of the whitened ones (1 if true).

    Whitened is what is left of bunches after all others for the coil, after the fit for a body,
    which is below one as it has pulled the shape to itself.
    """

    name: str
    count: int
    rms: Array
    whitened: float


def fits(found: Found) -> tuple[StreamFit, ...]:
    """How well the coil and every body fit."""
    model = found.model
    left = replace(model, bunch=1).residual(found.rig).reshape(-1, ROWS)
    whitened = float(np.sqrt(np.mean(innovations(found) ** 2)))
    out = [StreamFit(model.data.coil_name, len(left), _rms(left), whitened)]
    shape = model.shape
    for readings in body_readings(model.data):
        at = states_at(shape.prior, shape.grid, shape.state, readings.arclength, readings.time)
        left = readings.residual(at)
        whitened = float(np.sqrt(np.mean(left**2 / readings.cov.diagonal())))
        out.append(StreamFit(readings.name, len(left), _rms(left), whitened))
    return tuple(out)


def _rms(left: Array) -> Array:
    return np.sqrt([np.mean(left[:, :3] ** 2), np.mean(left[:, 3:] ** 2)])


def unseen(cov: Array, std: Array) -> list[str]:
    """Names of what is known little better than before, in any direction of each group."""
    names = []
    for name, (at, _) in _GROUPS.items():
        before = std[at]
        if np.all(before > 0.0):
            share = cov[at, at] / np.outer(before, before)
            if np.sqrt(np.linalg.eigvalsh(share)[-1]) > _LEARNED:
                names.append(name)
    return names


def advice(data: RigData, cov: Array, std: Array) -> tuple[str, ...]:
    """A sentence on everything that is known little better than before, and what would show it."""
    names = unseen(cov, std)
    told = []
    for name in names:
        at, motion = _GROUPS[name]
        if data.bodies or name in ("the lead scale", "the slide's delay"):
            after, before = np.sqrt(cov.diagonal()[at]).max(), std[at].max()
            told.append(
                f"{name[0].upper()}{name[1:]} is known little better than before (±{after:.2g} of "
                f"±{before:.2g}): {motion}."
            )
    if data.bodies and "the tracker's delay" in names and data.slides:
        apart = np.zeros(len(PARAMETERS))
        apart[list(_CLOCKS)] = -1.0, 1.0
        spread = float(np.sqrt(apart @ cov @ apart))
        if spread < _LEARNED * std[_CLOCKS[0]]:
            told.append(
                f"How far the clocks of slide and tracker are apart is known to {1e3 * spread:.2g} "
                f"ms all the same."
            )
    return tuple(told)
