"""Real devices: what moves the sensor and what measures it."""

from glissando.drivers.slide import Slide, SlideReading
from glissando.drivers.stage import Stage

__all__ = ["Slide", "SlideReading", "Stage"]
