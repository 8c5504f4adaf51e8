"""Drivers of real devices; each is a context manager that says what is wrong in a sentence."""

from glissando.drivers.aurora import Aurora as Aurora
from glissando.drivers.vicon import ViconFrame as ViconFrame
from glissando.drivers.vicon import ViconStream as ViconStream
