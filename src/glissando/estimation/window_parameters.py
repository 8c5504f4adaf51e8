"""What a sliding window knows of sensor parameters, from one beginning to the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter

_FAR = 3.0  # standard deviations by which a delay may be longer than it is estimated
_LOST = 6.0  # stated standard deviations that no delay is off


class NotLinearError(Exception):
    """What is read is beyond what a linear belief allows."""


class WindowParameters:
    """Sensor parameters of a window, which go on where it begins anew.

    Attributes:
        process: The parameters as they are stated.
    """

    def __init__(self, process: EstimatedParameters) -> None:
        self.process = process
        self.forget()
        self._begun = self._settled[1:]

    def forget(self) -> None:
        """Go on with what is stated."""
        self._settled = 0.0, self.process.mean, np.diag(self.process.std**2)

    def settle(self, time: float, values: Array, cov: Array) -> None:
        """Note what is known at a time: values (E,) and covariance (E, E).

        Raises:
            NotLinearError: A delay is further off than what is stated of it allows, as steps in
                error go; what is stated holds again.
        """
        off = np.abs(values - self.process.mean) > _LOST * self.process.std
        if off[self.process.delay_columns].any():
            self.forget()
            raise NotLinearError
        self._settled = time, values, cov

    def begin(self, time: float) -> tuple[Array, Array]:
        """Values (E,) and covariance (E, E) at a time, by what was known when settled."""
        settled, *known = self._settled
        self._begun = self.process.faded(time - settled, *known)
        return self._begun

    def believed(self) -> list[SensorParameter]:
        """The sensor parameters as they were known when the first node began."""
        values, cov = self._begun
        std = np.sqrt(np.diagonal(cov))
        pairs = zip(self.process.each, self.process.columns, strict=True)
        return [replace(p, value=values[at], std=std[at]) for p, at in pairs]

    def longest_delay(self, values: Array, std: Array) -> float:
        """How far, s, a reading may be from its stamp by delays that are estimated so (E,)."""
        reach = np.abs(values) + _FAR * std
        return float(np.max(reach[self.process.delay_columns], initial=0.0))
