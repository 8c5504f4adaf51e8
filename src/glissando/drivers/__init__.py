"""Drivers of real devices; each is a context manager that says what is wrong in a sentence."""

from glissando.drivers.aurora import Aurora
from glissando.drivers.slide import Slide, SlideReading
from glissando.drivers.stage import Stage
from glissando.drivers.vicon import ViconFrame, ViconStream

__all__ = ["Aurora", "Slide", "SlideReading", "Stage", "ViconFrame", "ViconStream"]
