"""What an experiment gives its devices: times of a path, and names of coils."""

from types import SimpleNamespace

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.capture import Coil
from glissando.hardware.capture.capture import _motion
from glissando.hardware.capture.coil_names import name_by_handle
from glissando.hardware.drivers.aurora_setup import Tool
from glissando.model.slide_path import SlideLimits, SlidePath

TOOLS = [Tool(10, "S1", "01", "00"), Tool(11, "S2", "02", "00")]


@pytest.mark.parametrize("duration", [36.300000000000004, 0.29, 0.004, 1.0])
def test_a_stage_is_given_times_that_increase_to_the_paths_end(duration):
    path = SlidePath.hold(0.0, duration, SlideLimits(1.0, 1.0, 1.0))
    stage = SimpleNamespace(follow=lambda times, travel: (times, travel))
    times, travel = _motion(stage, path, None)
    assert times[0] == 0.0
    assert times[-1] == path.duration
    steps = np.diff(times)
    assert 0.0 < steps.min() <= steps.max() < 0.01 + 1e-12
    assert travel.shape == times.shape


@pytest.mark.parametrize("order", [1, -1])
def test_a_coil_without_a_number_takes_a_plug_that_no_other_is_identified_by(order):
    coils = (Coil("free", 0.1), Coil("tip", 0.2, serial="S1"))[::order]
    assert name_by_handle(TOOLS, coils) == {10: "tip", 11: "free"}
    with pytest.raises(DeviceError, match="plug other in, or leave it out"):
        name_by_handle(TOOLS, (*coils, Coil("other", 0.3)))
