"""A rig: what its devices said in a session, each on a clock of its own, and what is to be found.

The clock of motion capture is time itself and its frame the world. A device whose stamps are late
by `delay + rate · (stamp − epoch)` says stamp at the time stamp − delay − rate · (stamp − epoch).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from glissando.geometry import se3
from glissando.geometry.se3 import Array

PARAMETERS = (
    *(f"frame {part}" for part in ("x", "y", "z", "rotation x", "rotation y", "rotation z")),
    *(f"mount {part}" for part in ("x", "y", "tilt x", "tilt y")),
    *("zero", "lead", "backlash"),
    *("tracker delay", "tracker rate", "slide delay", "slide rate"),
)
"""What is estimated, in the order of every covariance: m, rad, s, and 1 for lead and rates."""
MOUNT = np.array([0, 1, 3, 4])
"""Of a twist, what a coil without roll shows of its mount; along z it is the slide's zero."""
_BUNCH = 0.1  # s in which errors but the white ones stay alike


def _vector(*values: float) -> Array:
    return np.array(values, dtype=float)


@dataclass(frozen=True)
class Noise:
    """How wrong readings are, standard deviations of one component each.

    `mocap` and `coil` [m, rad] are white. `bias` [m, rad, length m] of the tracker belongs to the
    place in its field and is alike over so many metres. `play` [m, length m] is the radial
    clearance in which the coil's tube lies somewhere, alike over so many metres of arclength.
    `backlash` m is how much play there may be between carriage and coil.
    """

    mocap: Array = field(default_factory=lambda: _vector(2e-4, 2e-3))
    coil: Array = field(default_factory=lambda: _vector(1e-4, 1e-3))
    bias: Array = field(default_factory=lambda: _vector(4e-4, 5e-3, 0.1))  # [inferred] of Aurora
    play: Array = field(default_factory=lambda: _vector(3e-4, 0.075))
    backlash: float = 1e-4


@dataclass(frozen=True)
class Body:
    """A motion capture body on the robot: `poses` (B, 4, 4) T_wm at `time` (B,), seen ones only.

    It sits at `arclength` metres with the mount T_bm (4, 4).
    """

    arclength: float
    mount: Array
    time: Array
    poses: Array


@dataclass(frozen=True)
class RigData:
    """What a session holds: coil poses T_tc (M, 4, 4), travel (L,) in m, bodies by name.

    Times are in seconds of each device's own stamps; nothing may be empty but what is missing.
    `coil_arclength` is where the coil is expected at travel 0, within `coil_arclength_std`;
    `direction` is ±1, or 0 when it is not known. A robot's name or file may be known.
    """

    coil_name: str
    coil_time: Array
    coil: Array
    slide_time: Array
    travel: Array
    bodies: dict[str, Body]
    coil_arclength: float
    coil_arclength_std: float
    direction: int = 0
    noise: Noise = field(default_factory=Noise)
    robot: str = ""

    @property
    def slides(self) -> bool:
        """Whether there is a slide."""
        return self.slide_time.size > 1

    def thinned(self, count: int) -> RigData:
        """The same with at most so many coil readings, evenly chosen."""
        if self.coil_time.size <= count:
            return self
        rows = np.unique(np.linspace(0, self.coil_time.size - 1, count).round().astype(int))
        return self.at(rows)

    @property
    def bunch(self) -> int:
        """How many coil readings, an odd number, follow each other within a tenth of a second."""
        if self.coil_time.size < 2:
            return 1
        step = float(np.median(np.diff(self.coil_time)))
        return 2 * int(0.505 * _BUNCH / step) + 1  # a little more, for a clock that runs slow

    def bunches(self, size: int, count: int) -> RigData:
        """The same with at most `count` bunches of `size` readings without gaps, evenly chosen."""
        first = np.arange(0, self.coil_time.size - size + 1, size)
        lasts = self.coil_time[first + size - 1] - self.coil_time[first]
        first = first[lasts < 1.5 * _BUNCH]
        if first.size > count:
            first = first[np.linspace(0, first.size - 1, count).round().astype(int)]
        return self.at((first[:, None] + np.arange(size)).ravel())

    def at(self, rows: NDArray[np.intp]) -> RigData:
        """The same with some of the coil's readings."""
        return replace(self, coil_time=self.coil_time[rows], coil=self.coil[rows])


@dataclass(frozen=True)
class Rig:
    """Values of what is to be found, as `Calibration` documents them."""

    T_wt: Array
    direction: int
    zero: float
    epoch: float
    mount: Array = field(default_factory=lambda: np.zeros(4))
    lead: float = 1.0
    backlash: float = 0.0
    tracker_clock: Array = field(default_factory=lambda: np.zeros(2))
    slide_clock: Array = field(default_factory=lambda: np.zeros(2))

    def moved(self, step: Array) -> Rig:
        """The rig moved by `step` (17,) in the order of PARAMETERS, the frame on the right."""
        return replace(
            self,
            T_wt=self.T_wt @ se3.exp(step[:6]),
            mount=self.mount + step[6:10],
            zero=self.zero + float(step[10]),
            lead=self.lead + float(step[11]),
            backlash=self.backlash + float(step[12]),
            tracker_clock=self.tracker_clock + step[13:15],
            slide_clock=self.slide_clock + step[15:17],
        )

    @property
    def coil_mount(self) -> Array:
        """The coil in the cross-section, T_bc (4, 4), as far as it is seen.

        Roll is not, and along z it is the slide's zero.
        """
        twist = np.zeros(6)
        twist[MOUNT] = self.mount
        return se3.exp(twist)

    def true_time(self, stamps: Array) -> Array:
        """Time (M,) of a coil's stamps."""
        delay, rate = self.tracker_clock
        return stamps - delay - rate * (stamps - self.epoch)

    def slide_stamps(self, time: Array) -> Array:
        """What the slide's clock says at true times (M,)."""
        delay, rate = self.slide_clock
        return (time + delay - rate * self.epoch) / (1.0 - rate)

    def arclength(self, time: Array, slide_time: Array, travel: Array) -> Array:
        """Arclength (M,) of the coil at true times: zero + direction · lead · what it travelled.

        The coil follows the carriage with play of `backlash` metres.
        """
        if slide_time.size < 2:
            return np.full(time.shape, self.zero)
        stamps = self.slide_stamps(time)
        followed = np.interp(stamps, slide_time, travel - 0.5 * self.backlash * side(travel))
        return self.zero + self.direction * self.lead * followed


def side(travel: Array, width: float = 1e-4) -> Array:
    """On which side of its play the coil is (L,), −1 to 1, were the play `width` metres wide.

    It is taken as independent of the play's true width, so that what is found of it is linear.

    >>> side(np.array([0.0, 1e-3, 2e-3, 1e-3])).tolist()
    [0.0, 1.0, 1.0, -1.0]
    """
    out, behind = np.zeros(travel.size), 0.0
    steps = np.diff(travel) / (0.5 * width)
    for k, step in enumerate(steps.tolist()):
        behind = min(1.0, max(-1.0, behind + step))
        out[k + 1] = behind
    return out
