"""A slide's track says what a whole recording of it says, as far as it has come."""

import numpy as np
import pytest
from hypothesis import given, settings

from draws import generators
from glissando.model.slide_track import SlideTrack, slide_motion


@settings(max_examples=40, deadline=None)
@given(generators)
def test_between_readings_a_slide_is_where_a_recording_says(rng):
    times = np.cumsum(rng.uniform(0.005, 0.3, 40))
    travels = np.cumsum(rng.normal(0.0, 2e-3, 40) * (rng.random(40) < 0.7))
    track = SlideTrack()
    for time, travel in zip(times, travels, strict=True):
        track.add(time, travel)
    for when in rng.uniform(times[0], times[-1], 20):
        motion, after = track.at(when), np.searchsorted(times, when)
        assert motion.travel == pytest.approx(np.interp(when, times, travels), abs=1e-12)
        rise = (travels[after] - travels[after - 1]) / (times[after] - times[after - 1])
        assert motion.speed == pytest.approx(rise, abs=1e-9)
    recorded = slide_motion(times, travels)
    if np.any(recorded["slide_way"]):
        at = [track.at(time) for time in times]
        np.testing.assert_allclose([a.way for a in at], recorded["slide_way"], atol=1e-9)


def test_before_its_first_reading_a_slide_is_unknown_and_beyond_the_newest_it_goes_on():
    track = SlideTrack()
    assert track.at(0.0) is None
    track.add(1.0, 0.02)
    assert track.at(0.999) is None
    assert track.at(1.9).travel == 0.02
    track.add(1.1, 0.03)
    assert track.at(1.15).travel == pytest.approx(0.035)
    assert track.at(2.09).travel == pytest.approx(0.04)  # for a tenth of a second
    assert track.at(2.11) is None  # it may be anywhere by now
    track.add(1.1, 0.5)  # it came twice
    track.add(1.05, 0.5)  # it came late
    assert track.at(1.1).travel == pytest.approx(0.03)
    track.add(5.0, 0.03)
    assert track.at(2.11).travel == pytest.approx(0.03)
    assert track.at(5.0).speed == 0.0  # a pause says nothing of a speed
