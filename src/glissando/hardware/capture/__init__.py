"""Simultaneous recording of a rig's tracker, slide and motion capture, real or simulated."""

from glissando.hardware.capture.capture import capture, write_recording
from glissando.hardware.capture.messages import Progress
from glissando.hardware.capture.setup import Body, Coil, FurtherStage, Rig, load_rig
from glissando.hardware.capture.simulated import simulated_rig

__all__ = [
    "Body", "Coil", "FurtherStage", "Progress", "Rig", "capture", "load_rig", "simulated_rig",
    "write_recording",
]  # fmt: skip
