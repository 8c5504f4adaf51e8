"""Monitor of an online estimate that warns of wrong readings, once for each cause."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping

import numpy as np

from glissando.errors import EstimateWarning, FalseConfidenceWarning
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.robot import base_std
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_RESTARTS = 10  # restarts of a window, from which on their share of the updates is checked
_UNIT = 20.0  # lengths of the robot: larger arclengths are in another unit
_LOST, _MOST = 20, 0.9  # least number and share of a stream's readings out of time to warn of
_BEGINNING = 6  # updates not checked: readings before the first lie before the window
_REACH, _AT_BASE = 1.4, 0.1  # of arclength and of length: no robot stretches farther from the base
_STDS = 4.0  # standard deviations of its position that a base may be away


class OnlineMonitor:
    """Warns, once for each cause, of readings that an online estimate shows to be wrong.

    Attributes:
        beyond: Whether the newest state is beyond the robot's reach.
    """

    def __init__(self, prior: Prior, arclength: Array, time_rate: float = 1.0) -> None:
        """Begin without a warning.

        Args:
            prior: Prior of the robot's motion.
            arclength: Arclength nodes (N,), m.
            time_rate: Time nodes a second, for a base of which a density is stated.
        """
        rest = prior.rest_state(Grid(arclength, [0.0])).pose[0, 0, :3, 3]
        self._base, self._arclength = rest if prior.fixes_base else None, arclength
        away = max(_AT_BASE * arclength[-1], _STDS * base_std(prior, time_rate))
        self._reach = (_REACH * arclength + away) ** 2  # m²
        self._advances, self.beyond = 0, False
        self._reported_restarts = self._reported_reach = False
        self._reported_start = ""  # sentence of the last start
        self._farthest = _UNIT * float(arclength[-1])
        self._reported_places: set[str] = set()  # streams
        self._added, self._reported_times = Counter[str](), set[str]()

    def check_places(self, readings: Readings) -> None:
        """Check the arclengths of readings, before those off the robot are dropped."""
        self._added[readings.label] += len(readings)
        place = readings.arclength
        if not len(place) or place[0] <= self._farthest or readings.label in self._reported_places:
            return
        self._reported_places.add(readings.label)
        _warn(
            f"{readings.label} reads at {place[0]:g} m of a robot of {self._arclength[-1]:g} m and "
            f"is left out; give metres, not millimetres."
        )

    def check_times(self, dropped: Mapping[str, Mapping[str, int]]) -> None:
        """Check how many readings of each stream were `dropped` as late or ahead."""
        if self._advances < _BEGINNING:
            return
        for label, counts in dropped.items():
            lost = counts.get("late", 0) + counts.get("ahead", 0)
            if lost < max(_LOST, _MOST * self._added[label]) or label in self._reported_times:
                continue
            self._reported_times.add(label)
            _warn(
                f"{lost} of {self._added[label]} readings of {label} are left out: they lie before "
                f"the window, or more than two seconds ahead. Give the time of their clock, in "
                f"seconds, to advance(), as often as they come, or a longer window.",
                EstimateWarning,
            )

    def check_start(self, ambiguity: str) -> None:
        """Check the sentence on other motions that the readings of the window's start fit."""
        if ambiguity and ambiguity != self._reported_start:
            _warn(f"The smoother has started from its first readings. {ambiguity}")
        self._reported_start = ambiguity

    def check_state(self, newest: State, restarts: int) -> None:
        """Check the newest nodes (N,) and the number of restarts of the window."""
        self._advances += 1
        restarting = restarts >= _RESTARTS and 2 * restarts >= self._advances
        if restarting and not self._reported_restarts:
            self._reported_restarts = True
            _warn(
                f"The window began again from rest at {restarts} of {self._advances} times: what "
                f"was read is forgotten or contradicted by the next. Give times in seconds, not "
                f"milliseconds, read more often, and check the readings' units, frames and mounts."
            )
        place = newest.pose[:, :3, 3]
        off = place - (place[0] if self._base is None else self._base)
        excess = np.einsum("ni,ni->n", off, off) - self._reach
        self.beyond = bool(excess.max() > 0.0)
        if self.beyond and not self._reported_reach:
            self._reported_reach, worst = True, int(np.argmax(excess))
            _warn(
                f"The estimate is {np.linalg.norm(off[worst]):.3g} m from the base at "
                f"{self._arclength[worst]:.3g} m of the robot, beyond its reach: readings are in "
                f"another unit (mm for m) or frame, or the base is elsewhere. Until that ends "
                f"`fits` is False."
            )


def _warn(sentence: str, category: type[Warning] = FalseConfidenceWarning) -> None:
    warnings.warn(sentence, category, stacklevel=4)
