"""The shape that is shown while a session is recorded, and a view that fails."""

from contextlib import contextmanager
from urllib.request import urlopen

import pytest

from glissando.hardware.capture import Coil, Rig
from glissando.hardware.capture.online import live_estimate
from glissando.visualization.page.live import Live, follow
from waiting import until

pytestmark = pytest.mark.alone


@pytest.mark.slow
def test_the_shape_can_be_looked_at_while_it_is_recorded():
    pytest.importorskip("viser")
    rig = Rig("bench", "sliding700", coils=(Coil("coil", 0.7),))
    with live_estimate(rig, Live, follow) as (address, on_message):
        on_message("/slide", {"travel": 0.01})
        seen = {"position": [0.0, 0.0, 0.69], "quaternion": [1.0, 0.0, 0.0, 0.0]}
        for k in range(3):
            on_message("/tracker/coil", {"time": 0.1 * k, **seen})
        with urlopen(address, timeout=20) as page:
            assert page.status == 200


class Failing:
    """A view that fails as soon as it is shown something."""

    address = "nowhere"


@contextmanager
def open_failing(arclength):
    yield Failing()


def fail(view, smoother):
    raise SystemExit(1)


@pytest.mark.slow
def test_a_view_that_fails_is_said_once_and_nothing_waits_for_it(capfd):
    rig = Rig("bench", "sliding700", coils=(Coil("coil", 0.7),))
    seen = {"position": [0.0, 0.0, 0.7], "quaternion": [1.0, 0.0, 0.0, 0.0]}
    with live_estimate(rig, open_failing, fail) as (_, on_message):
        on_message("/tracker/coil", {"time": 0.0, **seen})
        told = []

        def said():
            on_message("/tracker/coil", {"time": 1.0, **seen})
            told.append(capfd.readouterr().err)
            return any("live view has ended; the recording goes on" in text for text in told)

        until(said)
        said()
    assert sum(text.count("live view has ended") for text in told) == 1
