"""A stage driven by an OpenIGTLink peer: goals as TRANSFORM, and measured positions in return."""

from __future__ import annotations

import time
from collections import Counter
from typing import Self

import numpy as np

from glissando.hardware.drivers.remote_stage import RemoteStage
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.address import Address, WireFrame
from glissando.hardware.openigtlink.endpoint import Endpoint
from glissando.hardware.openigtlink.message import Message, encode, stamp_of
from glissando.hardware.openigtlink.sender_clock import SenderClock
from glissando.hardware.openigtlink.tracker import poses_in

COMMAND, MEASURED = "StageTarget", "Stage"


class IgtlStagePeer:
    """Sends goals and receives positions along z of the stage's own frame; a context manager.

    A SENSOR message contains the position as its first number, in its own unit.

    Args:
        address: Address as `Endpoint` takes it.
        stage: Settings with the names of the devices for goals and positions.

    Attributes:
        counts: Events of the connection by name.

    Raises:
        DeviceError: The address is invalid.
    """

    def __init__(self, address: str, stage: RemoteStage) -> None:
        self._endpoint, self.counts = Endpoint(address), Counter[str]()
        self._frame = WireFrame.of(self._endpoint.address)
        self._clock = SenderClock(Address.of_rig(address).clock)
        self._command, self._measured = stage.command or COMMAND, stage.measured or MEASURED

    def __enter__(self) -> Self:
        self._endpoint.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.counts += self._endpoint.counts
        self._endpoint.close()

    def positions(self) -> list[tuple[float, float]]:
        """Times and positions that have arrived, from a limited number of messages."""
        out = []
        for arrival, message in self._endpoint.receive_all():
            if places := self._places(message):
                out.append((self._clock.monotonic(message.stamp, arrival), places[0]))
        return out

    def _places(self, message: Message) -> list[float]:
        content, poses = message.content, poses_in(message, self._frame)
        if isinstance(content, c.SensorValues) and message.device == self._measured:
            unit = self._frame.length_unit(content.unit)
            return [unit * float(value) for value in content.values[:1]]
        return [float(pose[2, 3]) for name, _, pose in poses if name == self._measured]

    def send(self, place: float, speed: float) -> None:
        """Send a goal; the speed is ignored, as the protocol cannot represent it."""
        pose = np.eye(4)
        pose[2, 3] = place
        goal = c.Transform(self._frame.poses_out(pose))
        self._endpoint.send([encode(Message(goal, self._command, stamp_of(time.time())))])

    @property
    def problem(self) -> str:
        """Reason why no positions arrive; empty while a peer is connected."""
        return "" if self._endpoint.peers else f"nobody answers at {self._endpoint.text}"
