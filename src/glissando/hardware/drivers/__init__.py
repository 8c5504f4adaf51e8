"""Drivers of real devices; each is a context manager that says what is wrong in a sentence."""

from glissando.hardware.drivers.aurora import Aurora
from glissando.hardware.drivers.slide import Slide, SlideReading
from glissando.hardware.drivers.stage import Stage
from glissando.hardware.drivers.vicon import ViconFrame, ViconStream

__all__ = ["Aurora", "Slide", "SlideReading", "Stage", "ViconFrame", "ViconStream"]
