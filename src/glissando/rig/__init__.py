"""A rig: tracker, slide and motion capture recorded together, real or simulated."""

from glissando.rig.capture import Progress, capture
from glissando.rig.folder import write_recording
from glissando.rig.setup import Body, Coil, Rig, load_rig
from glissando.rig.simulated import simulated_rig

__all__ = [
    "Body",
    "Coil",
    "Progress",
    "Rig",
    "capture",
    "load_rig",
    "simulated_rig",
    "write_recording",
]
