"""Estimates of sensor parameters that a sliding window keeps when it begins again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter

_FAR = 3.0  # standard deviations by which a delay may be longer than its estimate
_LOST = 6.0  # stated standard deviations beyond which the estimate of a delay is rejected


class NotLinearError(Exception):
    """Readings contradict the estimate by more than its linearisation allows."""


class WindowParameters:
    """Sensor parameters of a window, kept when it begins again.

    Attributes:
        process: The parameters with their stated priors.
    """

    def __init__(self, process: EstimatedParameters) -> None:
        self.process = process
        self.forget()
        self._begun = self._settled[1:]

    def forget(self) -> None:
        """Return to the stated priors."""
        self._settled = 0.0, self.process.mean, np.diag(self.process.std**2)

    def settle(self, time: float, values: Array, cov: Array) -> None:
        """Record values (E,) and covariance (E, E) at a time.

        Raises:
            NotLinearError: A delay is farther off than its stated uncertainty allows, as after
                erroneous steps; the stated priors are restored.
        """
        off = np.abs(values - self.process.mean) > _LOST * self.process.std
        if off[self.process.delay_columns].any():
            self.forget()
            raise NotLinearError
        self._settled = time, values, cov

    def begin(self, time: float) -> tuple[Array, Array]:
        """Values (E,) and covariance (E, E) at a time, propagated from those recorded last."""
        settled, *known = self._settled
        self._begun = self.process.faded(time - settled, *known)
        return self._begun

    def believed(self) -> list[SensorParameter]:
        """Sensor parameters with values and std at the time when the window began."""
        values, cov = self._begun
        std = np.sqrt(np.diagonal(cov))
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [replace(p, value=values[at], std=std[at]) for p, at in pairs]

    def longest_delay(self, values: Array, std: Array) -> float:
        """Largest shift, s, of a reading from its time stamp, by values and std (E,)."""
        reach = np.abs(values) + _FAR * std
        return float(np.max(reach[self.process.delay_columns], initial=0.0))
