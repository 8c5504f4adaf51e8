"""Drivers for a rig's devices, chosen by their addresses and settings; not yet entered."""

from __future__ import annotations

from contextlib import AbstractContextManager

from glissando.hardware.capture.remote_tracker import remote_tracker
from glissando.hardware.capture.setup import Rig, is_remote
from glissando.hardware.drivers import (
    GcodeSlide,
    GcodeStage,
    LinearStage,
    PositionStage,
    RemoteSlide,
    RemoteStage,
    Slide,
    Stage,
    Tracker,
)
from glissando.hardware.openigtlink.stage import IgtlStagePeer
from glissando.hardware.openigtlink.tracker import IgtlTracker
from glissando.hardware.ros2.ros2_stage import Ros2StagePeer
from glissando.hardware.ros2.ros2_tracker import Ros2Tracker


def opened_tracker(rig: Rig, address: str) -> AbstractContextManager[Tracker]:
    """Driver of the tracker at an address: OpenIGTLink, ROS 2 or otherwise an Aurora."""
    names = [coil.serial or coil.name for coil in rig.coils]
    if address.startswith("igtl"):
        return IgtlTracker(address, names)
    if is_remote(address):
        return Ros2Tracker(address, names)
    return remote_tracker(address, rig.baud)


def opened_stage(address: str, stage: PositionStage) -> LinearStage:
    """Driver of the stage at an address, chosen by the type of its settings."""
    if isinstance(stage, GcodeStage):
        return GcodeSlide(address, stage)
    if isinstance(stage, RemoteStage):
        kind = IgtlStagePeer if address.startswith("igtl") else Ros2StagePeer
        return RemoteSlide(stage, kind(address, stage))
    assert isinstance(stage, Stage)
    return Slide(address, stage)
