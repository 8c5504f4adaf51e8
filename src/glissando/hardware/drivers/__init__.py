"""Drivers of real devices: context managers whose errors state the cause and the remedy."""

from glissando.hardware.drivers.aurora import Aurora
from glissando.hardware.drivers.gcode import GcodeSlide, GcodeStage
from glissando.hardware.drivers.interfaces import LinearStage, SlideReading, Tracker
from glissando.hardware.drivers.position_stage import PositionStage
from glissando.hardware.drivers.remote_stage import RemoteSlide, RemoteStage
from glissando.hardware.drivers.slide import Slide
from glissando.hardware.drivers.stage import Stage
from glissando.hardware.drivers.vicon import ViconFrame, ViconStream

__all__ = [
    "Aurora", "GcodeSlide", "GcodeStage", "LinearStage", "PositionStage", "RemoteSlide",
    "RemoteStage", "Slide", "SlideReading", "Stage", "Tracker", "ViconFrame", "ViconStream",
]  # fmt: skip
