"""A check that a sensor's own Jacobian is the derivative of its residual."""

from __future__ import annotations

import numpy as np

from glissando.errors import SensorError
from glissando.model.sensors.numerical_jacobian import numerical_jacobian
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF, State

_ROWS = 3  # readings that are checked
_MOVED = 0.1  # m, rad and so on, away from rest, where many residuals have zero slope
_TOLERANCE = 1e-3  # largest error of a derivative, relative to the largest of a reading

_checked: set[type] = set()  # classes that passed the check


def require_own_jacobian(readings: Readings, rest: State) -> None:
    """Raise SensorError if jacobian(at) differs from the derivative of residual(at), or that is 0.

    Sensors of the package are not checked, other classes are checked once.

    Args:
        readings: Readings of the sensor.
        rest: States (N,) of one shape of the robot, of which the last is used.
    """
    kind = type(readings)
    known = kind in _checked or kind.__module__.startswith("glissando.")
    if known or not len(readings) or not readings.reads_one_state:
        return
    few = readings.select(slice(0, _ROWS))
    rng = np.random.default_rng(0)
    at = rest.take(np.full(len(few), -1)).retract(_MOVED * rng.standard_normal((len(few), DOF)))
    try:
        differences = numerical_jacobian(few, at)
    except (SensorError, ValueError, IndexError, TypeError):
        return  # errors of the residual are reported where it is used
    if not differences.any() and kind.jacobian is Readings.jacobian:
        raise SensorError(
            f"{readings.label}: residual(at) does not change with pose, strain or velocity, so its "
            f"readings say nothing; leave rounding out of it, and use `at`."
        )
    own = np.asarray(few.jacobian(at))
    if own.shape != differences.shape or not np.isfinite(differences).all():
        return
    scale = 1.0 + np.abs(differences).max(axis=(-1, -2), keepdims=True)
    gap = np.abs(own - differences)
    if not np.all(gap <= _TOLERANCE * scale):
        row, line, column = np.unravel_index(int(np.argmax(gap / scale)), gap.shape)
        raise SensorError(
            f"{readings.label}: jacobian(at) has {own[row, line, column]:.4g} in column {column}, "
            f"and residual(at) changes by {differences[row, line, column]:.4g} there; poses are "
            f"perturbed on the right, in the body's axes. Correct it, or leave jacobian out."
        )
    _checked.add(kind)
