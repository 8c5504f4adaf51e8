"""A peer as a tracker or a stage: whatever it sends, an answer comes in time."""

import time

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.drivers import RemoteStage
from glissando.hardware.openigtlink import Message
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.stage import IgtlStagePeer
from glissando.hardware.openigtlink.tracker import IgtlTracker

ADDRESS = "igtl://127.0.0.1:1?clock=arrival"


@pytest.mark.parametrize(
    "opened",
    [
        lambda address: IgtlTracker(address, ["tip"]),
        lambda address: IgtlStagePeer(address, RemoteStage(stroke=(0.0, 0.06))),
    ],
)
def test_a_device_of_a_rig_keeps_no_time_of_its_own(opened):
    with pytest.raises(DeviceError, match=r"this computer's time; give clock=fitted, shared or"):
        opened("igtl://127.0.0.1:1?clock=sender")


@pytest.mark.parametrize(
    "ask",
    [
        (IgtlTracker(ADDRESS, ["tip"]), lambda tracker: tracker.read(0.05)),
        (IgtlStagePeer(ADDRESS, RemoteStage(stroke=(0.0, 0.06))), IgtlStagePeer.positions),
    ],
)
def test_a_flood_of_other_devices_holds_nobody_up(ask):
    peer, question = ask
    began = time.monotonic()
    other = Message(c.Transform(np.eye(4)), "other", 1)

    def receive():
        now = time.monotonic()
        return [(now, other)] * 16 if now < began + 6.0 else []

    peer._endpoint.receive = receive
    assert not question(peer)
    assert time.monotonic() - began < 5.0
