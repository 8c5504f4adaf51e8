"""What speaks with devices: receivers and drivers, a file a device."""

from glissando.drivers.vicon import ViconFrame as ViconFrame
from glissando.drivers.vicon import ViconStream as ViconStream
