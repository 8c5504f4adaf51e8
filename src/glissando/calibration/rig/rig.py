"""Data of a calibration session, and the constants of the rig that calibration estimates.

Motion capture defines time and the world frame. Tracker and slide have their own clocks: a device
whose stamps are late by delay + rate · (stamp − epoch) measures at the time
stamp − delay − rate · (stamp − epoch).
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
"""Names of the constants in the order of every covariance; m, rad, s, and 1 for lead and rates."""
MOUNT = np.array([0, 1, 3, 4])
"""Entries of the mount's twist that are estimated: roll is unobservable, z is in the zero."""
ANYWHERE = 1.0
"""Prior standard deviation of the tracker's frame, m and rad."""
_PLAY = 1e-4  # m
_WIDEST = 0.05  # m: radius of a channel
_BLOCK = 0.1  # s in which all errors but white noise are taken as constant


def _vector(*values: float) -> Array:
    return np.array(values, dtype=float)


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the devices' errors, per component.

    Attributes:
        mocap: White noise of motion capture [m, rad].
        coil: White noise of the coil [m, rad].
        bias: Distortion of the tracker's field [m, rad], and its correlation length in space [m].
        play: Radial clearance of the coil's tube [m], and the correlation length along the robot
            [m] of the coil's offset in it.
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
        arclength: Arclength of the cross-section that carries the body, m.
        mount: Pose T_bm (4, 4) of the body in that cross-section.
        time: Times (B,) of the samples, s.
        poses: Poses T_wm (B, 4, 4) of the body in the world.
    """

    arclength: float
    mount: Array
    time: Array
    poses: Array


@dataclass(frozen=True)
class TubeBody:
    """A motion capture body on the sliding tube.

    Attributes:
        name: Name of the body.
        time: Times (B,) of the samples, s.
        poses: Poses T_wm (B, 4, 4) of the body in the world.
    """

    name: str
    time: Array
    poses: Array


@dataclass(frozen=True)
class RigData(ShortRepr):
    """Data of a calibration session; the arrays of a missing device are empty.

    Attributes:
        coil_name: Name of the coil.
        coil_time: Stamps of the tracker (M,), s.
        coil: Poses of the coil in the tracker's frame, T_tc (M, 4, 4).
        slide_time: Stamps of the slide (L,), s.
        travel: Travel of the slide by its encoder (L,), m.
        bodies: Motion capture bodies on the robot, by name.
        coil_arclength: Expected arclength of the coil at travel 0, m.
        coil_arclength_std: Standard deviation of `coil_arclength`, m.
        direction: Sign of d(arclength)/d(travel), ±1, or 0 if it is unknown.
        noise: Noise of the devices.
        robot: Name or file of the robot; empty if unknown.
        tube: Motion capture body on the sliding tube, or None.
        channel: Channel beside the backbone in which the coil slides, or None. With a channel, the
            coil's arclength is measured along it.
        others: The tracker's other coils, which are not calibrated.
        frame: Stated pose T_wt (4, 4) of the tracker in the world, or None.
        mount: Stated mount (4, 4) of the coil; the estimated mount multiplies it on the right.
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
        """Whether the session has samples of a slide."""
        return self.slide_time.size > 1

    @cached_property
    def side(self) -> Array:
        """Position of the coil within the backlash (L,), from −1 to 1.

        The backlash is taken as `_PLAY` whatever its true value, so that the coil's arclength is
        linear in the backlash.
        """
        return side_of_play(self.travel, _PLAY)

    def thinned(self, count: int) -> RigData:
        """Copy with at most `count` coil readings, evenly chosen."""
        if self.coil_time.size <= count:
            return self
        rows = evenly_chosen(self.coil_time.size, count)
        return self.at(rows)

    @property
    def block_size(self) -> int:
        """Odd number of consecutive coil readings that fit into a tenth of a second."""
        if self.coil_time.size < 2:
            return 1
        step = float(np.median(np.diff(self.coil_time)))
        return 2 * int(0.505 * _BLOCK / step) + 1  # a little more, for a clock that runs slow

    def blocks(self, size: int, count: int) -> RigData:
        """Copy with at most `count` blocks of `size` consecutive coil readings without gaps."""
        first = np.arange(0, self.coil_time.size - size + 1, size)
        lasts = self.coil_time[first + size - 1] - self.coil_time[first]
        first = first[lasts < 1.5 * _BLOCK]
        if first.size > count:
            first = first[evenly_chosen(first.size, count)]
        return self.at((first[:, None] + np.arange(size)).ravel())

    def at(self, rows: NDArray[np.intp]) -> RigData:
        """Copy with the coil readings at the indices `rows`."""
        return replace(self, coil_time=self.coil_time[rows], coil=self.coil[rows])


@dataclass(frozen=True)
class Rig:
    """Constants of a rig.

    Attributes:
        T_wt: Pose of the tracker in the world (4, 4).
        direction: Sign of d(arclength)/d(travel), ±1.
        zero: Arclength of the coil at travel 0, m.
        epoch: Stamp at which the clocks' rates contribute no delay, s.
        mount: Offsets x, y [m] and tilts about x, y [rad] of the coil from its stated mount. For a
            coil in a channel beside the backbone, x and y are the channel's offset from its stated
            place at the base.
        lead: Metres of arclength per metre of travel.
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
        """Rig updated by `step` (17,), in the order of PARAMETERS; the frame by a right twist."""
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
        """Pose (4, 4) of the coil relative to its stated mount; roll and z are zero."""
        twist = np.zeros(6)
        twist[MOUNT] = self.mount
        return se3.exp(twist)

    def channel(self, data: RigData) -> Channel | None:
        """The session's channel, displaced at the base by the mount's x, y; None without one."""
        stated = data.channel
        if stated is None:
            return None
        x, y = stated.path(np.zeros(1))[0][0, :2] + self.mount[:2]
        widest = min(_WIDEST, abs(stated.pitch))  # a step of the fit may go too far
        return Channel(min(float(np.hypot(x, y)), widest), float(np.arctan2(y, x)), stated.pitch)

    def mount_at(self, arclength: Array, data: RigData) -> Array:
        """Mount T_bc (4, 4) of the coil; in a channel (M, 4, 4), one for each arclength (M,)."""
        channel = self.channel(data)
        if channel is None:
            return self.whole_mount(data)
        straight = np.tile(STRAIGHT, (arclength.size, 1))
        return channel.frame(arclength, straight) @ self.whole_mount(data)

    def whole_mount(self, data: RigData) -> Array:
        """Stated times estimated mount (4, 4), in the cross-section or the channel's frame."""
        return data.mount @ (self.tilt if data.channel else self.coil_mount)

    @property
    def tilt(self) -> Array:
        """Pose (4, 4) relative to the stated mount with the tilts only, for a coil in a channel."""
        return replace(self, mount=np.append([0.0, 0.0], self.mount[2:])).coil_mount

    def true_time(self, stamps: Array) -> Array:
        """True times (M,) of the tracker's stamps, s."""
        delay, rate = self.tracker_clock
        return stamps - delay - rate * (stamps - self.epoch)

    def slide_stamps(self, time: Array) -> Array:
        """Stamps (M,) of the slide's clock at true times, s."""
        delay, rate = self.slide_clock
        return (time + delay - rate * self.epoch) / (1.0 - rate)

    def arclength(self, time: Array, data: RigData) -> Array:
        """Arclength (M,) of the coil: zero + direction · lead · (travel less backlash).

        For a coil in a channel, the distance along the channel from the base.

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
        """Whether the slide was recorded at true times (M,); True everywhere without a slide."""
        if not data.slides:
            return np.ones(time.shape, dtype=bool)
        stamps = self.slide_stamps(time)
        return np.asarray((stamps >= data.slide_time[0]) & (stamps <= data.slide_time[-1]))

    def minus(self, other: Rig) -> Array:
        """Difference (17,) of two rigs: the step for which other.moved(step) is this rig."""
        return np.concatenate(
            [
                se3.log(se3.inverse(other.T_wt) @ self.T_wt),
                self.mount - other.mount,
                [self.zero - other.zero, self.lead - other.lead, self.backlash - other.backlash],
                self.tracker_clock - other.tracker_clock,
                self.slide_clock - other.slide_clock,
            ]
        )
