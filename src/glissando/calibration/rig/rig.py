"""A rig: a session's data, each device with a clock of its own, and the constants to find.

Motion capture defines time and the world frame. A device whose stamps are late by
delay + rate · (stamp − epoch) measures at the time stamp − delay − rate · (stamp − epoch).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.other_coil import OtherCoil
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.evenly import evenly_chosen
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.short_repr import ShortRepr
from glissando.model.slide_track import side_of_play
from glissando.model.tendons.channel import Channel

PARAMETERS = (
    *(f"frame {part}" for part in ("x", "y", "z", "rotation x", "rotation y", "rotation z")),
    *(f"mount {part}" for part in ("x", "y", "tilt x", "tilt y")),
    *("zero", "lead", "backlash"),
    *("tracker delay", "tracker rate", "slide delay", "slide rate"),
)
"""The constants in the order of every covariance: m, rad, s, and 1 for lead and rates."""
MOUNT = np.array([0, 1, 3, 4])
"""Entries of the mount's twist that a coil shows: roll is not seen, z is the slide's zero."""
ANYWHERE = 1.0
"""Standard deviation of the tracker's frame before calibration, m and rad."""
_PLAY = 1e-4  # m
_WIDEST = 0.05  # m: radius of a channel
_BLOCK = 0.1  # s in which all errors but the white ones stay the same


def _vector(*values: float) -> Array:
    return np.array(values, dtype=float)


@dataclass(frozen=True)
class Noise:
    """Noise of the devices, as the standard deviation of each component.

    Attributes:
        mocap: White noise of motion capture [m, rad].
        coil: White noise of the coil [m, rad].
        bias: Distortion of the tracker's field [m, rad], and its correlation length [m] in space.
        play: Radial clearance of the coil's tube [m], and its correlation length [m] along the
            robot.
        backlash: Play between carriage and coil, m.
    """

    mocap: Array = field(default_factory=lambda: _vector(2e-4, 2e-3))
    coil: Array = field(default_factory=lambda: _vector(1e-4, 1e-3))
    bias: Array = field(default_factory=lambda: _vector(4e-4, 5e-3, 0.1))  # [inferred] of Aurora
    play: Array = field(default_factory=lambda: _vector(3e-4, 0.075))
    backlash: float = 1e-4


@dataclass(frozen=True)
class Body:
    """A motion capture body on the robot.

    Attributes:
        arclength: Where it sits, m.
        mount: T_bm (4, 4).
        time: Times (B,) at which it was seen, s.
        poses: T_wm (B, 4, 4).
    """

    arclength: float
    mount: Array
    time: Array
    poses: Array


@dataclass(frozen=True)
class TubeBody:
    """A motion capture body on the sliding tube.

    Attributes:
        name: Its name.
        time: Times (B,) at which it was seen, s.
        poses: T_wm (B, 4, 4).
    """

    name: str
    time: Array
    poses: Array


@dataclass(frozen=True)
class RigData(ShortRepr):
    """Data of a session; the arrays of a missing device are empty.

    Attributes:
        coil_name: Name of the coil.
        coil_time: Stamps of the tracker (M,), s.
        coil: Poses of the coil in the tracker's frame, T_tc (M, 4, 4).
        slide_time: Stamps of the slide (L,), s.
        travel: Travel by its encoder (L,), m.
        bodies: Motion capture bodies by name.
        coil_arclength: Expected arclength of the coil at travel 0, m.
        coil_arclength_std: Standard deviation of that, m.
        direction: Sign of arclength with travel, ±1, or 0 when it is not known.
        noise: Noise of the devices.
        robot: Name or file of the robot, if it is known.
        tube: The motion capture body on the sliding tube, if there is one.
        channel: The channel beside the backbone that the coil slides in, if there is one, along
            which its arclength is then measured.
        others: The tracker's other coils, which are not calibrated.
        frame: Pose T_wt (4, 4) of the tracker in the world as it was stated, if it was.
        mount: The coil's stated mount (4, 4), after which the one that is found comes.
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
    tube: TubeBody | None = None
    channel: Channel | None = None
    others: tuple[OtherCoil, ...] = ()
    frame: Array | None = None
    mount: Array = field(default_factory=lambda: np.eye(4))

    @property
    def slides(self) -> bool:
        """Whether there is a slide."""
        return self.slide_time.size > 1

    @cached_property
    def side(self) -> Array:
        """Side of the backlash on which the coil is (L,), from −1 to 1.

        It is computed for a backlash of `_PLAY` whatever the true one, so that the coil's arclength
        is linear in the backlash.
        """
        return side_of_play(self.travel, _PLAY)

    def thinned(self, count: int) -> RigData:
        """The same data with at most `count` coil readings, evenly chosen."""
        if self.coil_time.size <= count:
            return self
        rows = evenly_chosen(self.coil_time.size, count)
        return self.at(rows)

    @property
    def block_size(self) -> int:
        """Number of coil readings, odd, that follow each other within a tenth of a second."""
        if self.coil_time.size < 2:
            return 1
        step = float(np.median(np.diff(self.coil_time)))
        return 2 * int(0.505 * _BLOCK / step) + 1  # a little more, for a clock that runs slow

    def blocks(self, size: int, count: int) -> RigData:
        """The same data with at most `count` blocks of `size` readings without gaps."""
        first = np.arange(0, self.coil_time.size - size + 1, size)
        lasts = self.coil_time[first + size - 1] - self.coil_time[first]
        first = first[lasts < 1.5 * _BLOCK]
        if first.size > count:
            first = first[evenly_chosen(first.size, count)]
        return self.at((first[:, None] + np.arange(size)).ravel())

    def at(self, rows: NDArray[np.intp]) -> RigData:
        """The same data with some of the coil's readings."""
        return replace(self, coil_time=self.coil_time[rows], coil=self.coil[rows])


@dataclass(frozen=True)
class Rig:
    """Constants of a rig.

    Attributes:
        T_wt: Frame of the tracker in the world (4, 4).
        direction: Sign of arclength with travel, ±1.
        zero: Arclength of the coil at travel 0, m.
        epoch: Stamp about which the clocks' rates count, s.
        mount: x, y [m] and tilts about x, y [rad] of the coil in the cross-section, off its stated
            mount if there is one; of a coil in a channel beside the backbone, how far off the
            channel is at the base, and those tilts.
        lead: Metres of arclength for a metre of travel.
        backlash: Play between carriage and coil, m.
        tracker_clock: Delay [s] and rate of the tracker's stamps.
        slide_clock: Delay [s] and rate of the slide's stamps.
    """

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
        """The rig moved by `step` (17,) in the order of PARAMETERS; the frame by a right twist."""
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
        """The coil off its stated mount (4, 4), without roll and without shift along z."""
        twist = np.zeros(6)
        twist[MOUNT] = self.mount
        return se3.exp(twist)

    def channel(self, data: RigData) -> Channel | None:
        """The channel of a session's coil, moved at the base by the mount's x, y."""
        stated = data.channel
        if stated is None:
            return None
        x, y = stated.path(np.zeros(1))[0][0, :2] + self.mount[:2]
        widest = min(_WIDEST, abs(stated.pitch))  # a step of the fit may go too far
        return Channel(min(float(np.hypot(x, y)), widest), float(np.arctan2(y, x)), stated.pitch)

    def mount_at(self, arclength: Array, data: RigData) -> Array:
        """The coil in the cross-sections at arclengths (M,): T_bc (4, 4), or (M, 4, 4)."""
        channel = self.channel(data)
        if channel is None:
            return self.whole_mount(data)
        straight = np.tile(STRAIGHT, (arclength.size, 1))
        return channel.frame(arclength, straight) @ self.whole_mount(data)

    def whole_mount(self, data: RigData) -> Array:
        """The mount (4, 4) of the coil in the cross-section, or in its channel."""
        return data.mount @ (self.tilt if data.channel else self.coil_mount)

    @property
    def tilt(self) -> Array:
        """The coil off its stated mount (4, 4) in its channel."""
        return replace(self, mount=np.append([0.0, 0.0], self.mount[2:])).coil_mount

    def true_time(self, stamps: Array) -> Array:
        """Times (M,) of a tracker's stamps."""
        delay, rate = self.tracker_clock
        return stamps - delay - rate * (stamps - self.epoch)

    def slide_stamps(self, time: Array) -> Array:
        """Stamps (M,) of the slide at true times."""
        delay, rate = self.slide_clock
        return (time + delay - rate * self.epoch) / (1.0 - rate)

    def arclength(self, time: Array, data: RigData) -> Array:
        """Arclength (M,) of the coil: zero + direction · lead · its travel behind the backlash.

        Of a coil in a channel it is how far the coil was pushed in from the base.

        Args:
            time: True times (M,), s.
            data: The session with the slide's travel.
        """
        if not data.slides:
            return np.full(time.shape, self.zero)
        travel = data.travel - 0.5 * self.backlash * data.side
        followed = np.interp(self.slide_stamps(time), data.slide_time, travel)
        return self.zero + self.direction * self.lead * followed

    def covered(self, time: Array, data: RigData) -> NDArray[np.bool_]:
        """Which true times (M,) the slide's record covers; all of them without a slide."""
        if not data.slides:
            return np.ones(time.shape, dtype=bool)
        stamps = self.slide_stamps(time)
        return np.asarray((stamps >= data.slide_time[0]) & (stamps <= data.slide_time[-1]))

    def minus(self, other: Rig) -> Array:
        """The step (17,) with which other.moved(step) is this rig."""
        return np.concatenate(
            [
                se3.log(se3.inverse(other.T_wt) @ self.T_wt),
                self.mount - other.mount,
                [self.zero - other.zero, self.lead - other.lead, self.backlash - other.backlash],
                self.tracker_clock - other.tracker_clock,
                self.slide_clock - other.slide_clock,
            ]
        )
