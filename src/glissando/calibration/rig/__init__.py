"""What must be known of a rig before a sliding sensor is estimated, found from a session.

Clocks of tracker and slide against motion capture's, the tracker's frame, the coil's mount, and
where the coil is for what the slide's encoder says; all with their joint covariance.
"""

from glissando.calibration.rig.advice import StreamFit
from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.result import Calibration, apply, load_calibration
from glissando.calibration.rig.rig import PARAMETERS, Body, Noise, Rig, RigData
from glissando.calibration.rig.session_data import rig_data

__all__ = [
    "PARAMETERS",
    "Body",
    "Calibration",
    "Noise",
    "Rig",
    "RigData",
    "StreamFit",
    "apply",
    "calibrate",
    "load_calibration",
    "rig_data",
]
