"""A stage that another program drives: goals out, positions in, over ROS 2 or OpenIGTLink."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any, Protocol, Self

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.position_slide import PositionSlide
from glissando.hardware.drivers.position_stage import PositionStage
from glissando.model.table import Table

MESSAGES = ("joint_state", "float64_array")
_FIRST = 5.0  # s for the first position to come
_PATIENCE = 2.0  # s for a motion to stop
_STILL = 2e-3  # m/s: slower is at rest
_FAR = 20.0  # m: no stage of a laboratory
_LOOK = 0.002  # s
_AGAIN = 0.1  # s after which a stage that has not set out is sent its goal again


@dataclass(frozen=True)
class RemoteStage(PositionStage):
    """A stage behind a ROS 2 graph or an OpenIGTLink peer.

    Its `home` is the travel where its own position is zero, if it has homed itself.

    Attributes:
        command: Topic or device that goals are sent to; by default as `peer` names it.
        measured: Topic or device that positions come from; by default as `peer` names it.
        joint: Name of the joint in a JointState; empty for its first.
        message: What a goal in ROS 2 is, of `MESSAGES`.
        silence: Seconds without a position after which the stage is stopped.

    Raises:
        DeviceError: A value is impossible.
    """

    command: str = ""
    measured: str = ""
    joint: str = ""
    message: str = MESSAGES[0]
    silence: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.02 <= self.silence <= 5.0 or self.message not in MESSAGES:
            raise DeviceError(
                f"A silence of {self.silence:g} s and messages {self.message!r} cannot be; give "
                f"0.02 to 5 s, and {' or '.join(MESSAGES)}."
            )

    @classmethod
    def _own(cls, table: Table) -> dict[str, Any]:
        texts = {key: table.text(key, "") for key in ("command", "measured", "joint")}
        message = table.text("message", cls.message, choices=MESSAGES)
        return {**texts, "message": message, "silence": table.number("silence", cls.silence)}


class StagePeer(Protocol):
    """The program that drives a stage; a context manager."""

    counts: Counter[str]

    def __enter__(self) -> Self:
        """Join the peer."""

    def __exit__(self, *raised: object) -> None:
        """Leave it."""

    def positions(self) -> list[tuple[float, float]]:
        """Times of time.monotonic(), s, and positions, m, that have come; never waits."""

    def send(self, place: float, speed: float) -> None:
        """Send a goal: a position, m, and the speed towards it, m/s and signed."""

    @property
    def problem(self) -> str:
        """Why nothing comes, as a phrase; empty while all is well."""


class RemoteSlide(PositionSlide):
    """A stage behind a peer, to be used in a with-block; it stands still afterwards.

    Each reading is a position that came anew. If none comes for as long as its `silence`, the stage
    is sent the last one as its goal, and its travel is not known any more. A stage that stands
    where it was when it was sent a goal is sent it again: the first message in a ROS 2 graph is
    lost where the other node does not know of its publisher yet.

    Args:
        stage: Its limits.
        peer: Who drives it.

    Attributes:
        counts: Positions that were 'invalid', 'stale' or 'corrupt', and what the peer counts.
    """

    ahead, rate, least = 1, 50.0, 0.0
    stage: RemoteStage

    def __init__(self, stage: RemoteStage, peer: StagePeer) -> None:
        super().__init__(stage)
        self._peer, self.counts = peer, peer.counts
        self._newest = -np.inf, np.nan
        self._former = self._since = -np.inf  # when the positions before the newest, and last, came
        self._goal: tuple[float, float] | None = None

    def __enter__(self) -> Self:
        self._peer.__enter__()
        try:
            self._join(_FIRST)
        except BaseException:
            self._peer.__exit__()
            raise
        return self

    def _close(self) -> None:
        self._forget()
        self._peer.__exit__()

    def _home_place(self) -> float:
        return 0.0

    def _place(self) -> tuple[float, float]:
        if self._last is not None and self._last.time == self._newest[0]:
            self._since = self._former
        self._wait(self.stage.silence)
        return self._newest

    def _measured_after(self, last: SlideReading) -> float:
        """When the position before the last reading's came.

        After a stall of the host or the net several come at once, of which the first was measured
        long before.
        """
        return min(last.time, self._since)

    def _join(self, patience: float) -> None:
        """Wait until positions come and goals arrive.

        In a ROS 2 graph the driver's positions may come before it knows of this publisher of goals,
        and what is sent until then is lost.
        """
        end = monotonic() + patience
        self._wait(patience)
        while self._peer.problem and monotonic() < end:
            sleep(_LOOK)
        if self._peer.problem:
            raise DeviceError(
                f"The stage states where it is, but no goal reaches it ({self._peer.problem}); "
                f"check its driver and the name of `command`."
            )

    def _wait(self, patience: float) -> None:
        """Wait for a new position. Raises DeviceError when none comes in time."""
        last, end = self._newest[0], monotonic() + patience
        while True:
            for time, place in self._peer.positions():
                if not abs(place) < _FAR:
                    self.counts["invalid"] += 1
                elif time <= self._newest[0]:
                    self.counts["stale"] += 1
                else:
                    self._former, self._newest = self._newest[0], (time, place)
            if self._newest[0] > last:
                return
            if monotonic() > end:
                self._forget()
                why = self._peer.problem or "its positions are stale, or none came"
                raise DeviceError(
                    f"The stage has not stated where it is for {patience:g} s ({why}); check its "
                    f"driver and the unit it counts in, and home again."
                )
            sleep(_LOOK)

    def _aim(self, place: float, speed: float) -> None:
        self._goal = place, float(np.copysign(speed, place - self._newest[1]))
        self._peer.send(*self._goal)

    def _until_rest(self, goal: float, lasts: float) -> Iterator[SlideReading]:
        sent = monotonic()
        for reading in super()._until_rest(goal, lasts):
            if self._goal and self._stands(reading) and monotonic() - sent > _AGAIN:
                sent = monotonic()
                self._peer.send(*self._goal)
            yield reading

    def _stands(self, reading: SlideReading) -> bool:
        return abs(reading.speed) < _STILL

    def stop(self) -> None:
        """Have the stage hold where it was last, and wait until it does."""
        if self._goal is None:
            return  # nobody has moved it from here
        end, hold = monotonic() + _PATIENCE, self._newest[1]
        while True:
            self._peer.send(hold, 0.0)
            before, place = self._newest
            time, now = self._place()
            if abs(now - place) < _STILL * (time - before):
                return
            if monotonic() > end:
                self._forget()
                raise DeviceError("The stage does not stop; cut its supply, and home it again.")
