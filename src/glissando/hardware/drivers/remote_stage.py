"""A stage that another program drives, by goals and positions over ROS 2 or OpenIGTLink."""

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
_FIRST = 5.0  # s allowed for the first position to arrive
_PATIENCE = 2.0  # s allowed for a motion to stop
_STILL = 2e-3  # m/s, speed below which the stage is at rest
_FAR = 20.0  # m, beyond any laboratory stage
_LOOK = 0.002  # s between polls
_RESEND_INTERVAL = 0.1  # s at rest after which the goal is sent again


@dataclass(frozen=True)
class RemoteStage(PositionStage):
    """A stage behind a ROS 2 graph or an OpenIGTLink peer.

    `home` is the travel at its own position zero, if it has homed itself.

    Attributes:
        command: Topic or device to which goals are sent; the peer's default if empty.
        measured: Topic or device of the measured positions; the peer's default if empty.
        joint: Name of the joint in a JointState; empty for the first one.
        message: Type of a goal message in ROS 2, one of `MESSAGES`.
        silence: Seconds without a position after which the stage is stopped.

    Raises:
        DeviceError: A value is out of range.
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
    """Connection to the program that drives a stage; a context manager."""

    counts: Counter[str]

    def __enter__(self) -> Self:
        """Connect to the peer."""

    def __exit__(self, *raised: object) -> None:
        """Disconnect."""

    def positions(self) -> list[tuple[float, float]]:
        """Times, s of time.monotonic(), and positions, m, that have arrived; does not wait."""

    def send(self, place: float, speed: float) -> None:
        """Send a goal: a position, m, and the signed speed towards it, m/s."""

    @property
    def problem(self) -> str:
        """Reason, as a phrase, why no positions arrive; empty without a problem."""


class RemoteSlide(PositionSlide):
    """A stage behind a peer, used as a context manager; at rest after the block.

    Each reading waits for a new position. If none arrives within `silence`, the last position is
    sent as the goal, and the travel becomes unknown. A goal is sent again to a stage that remains
    at rest: in a ROS 2 graph, messages are lost until the other node has discovered their
    publisher.

    Args:
        stage: Limits of the stage.
        peer: Connection to the program that drives it.

    Attributes:
        counts: Positions that were 'invalid', 'stale' or 'corrupt', and events of the peer.
    """

    ahead, rate, least = 1, 50.0, 0.0
    stage: RemoteStage

    def __init__(self, stage: RemoteStage, peer: StagePeer) -> None:
        super().__init__(stage)
        self._peer, self.counts = peer, peer.counts
        self._newest = -np.inf, np.nan
        self._former = self._since = -np.inf  # times of the positions before newest and last
        self._goal: tuple[float, float] | None = None

    def __enter__(self) -> Self:
        self._peer.__enter__()
        try:
            self._wait_until_connected(_FIRST)
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
        """Time of the position before that of the last reading.

        After a stall of the host or the network several positions arrive at once, the first of
        which was measured long before.
        """
        return min(last.time, self._since)

    def _wait_until_connected(self, patience: float) -> None:
        """Wait until positions arrive and goals can be sent.

        In a ROS 2 graph the driver's positions may arrive before the driver has discovered the
        publisher of goals; goals sent earlier are lost.
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
        """Wait for a new position. Raises DeviceError if none arrives in time."""
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
            if self._goal and self._stands(reading) and monotonic() - sent > _RESEND_INTERVAL:
                sent = monotonic()
                self._peer.send(*self._goal)
            yield reading

    def _stands(self, reading: SlideReading) -> bool:
        return abs(reading.speed) < _STILL

    def stop(self) -> None:
        """Command the last position as the goal, and wait until the stage is at rest."""
        if self._goal is None:
            return  # no goal was sent, so nothing moves the stage from here
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
