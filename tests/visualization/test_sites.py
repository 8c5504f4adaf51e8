"""A picture shows a sensor once: where it slides, and where it is read at several places."""

import numpy as np
import pytest

from glissando import Grid, PositionReadings
from glissando.visualization.sites import sites_of

GRID = Grid(arclength=np.linspace(0.0, 0.5, 6), time=np.linspace(0.0, 1.0, 11))


def _stream(time, arclength):
    values = np.zeros((time.size, 3))
    return PositionReadings(time=time, arclength=arclength, values=values, cov=1e-6, name="coil")


@pytest.mark.parametrize("count", [1, 2, 5, 12, 13, 100])
def test_a_sensor_that_slides_is_one_site_however_few_its_readings(count):
    rng = np.random.default_rng(count)
    stream = _stream(np.sort(rng.uniform(0.0, 1.0, count)), rng.uniform(0.0, 0.5, count))
    (site,) = sites_of([stream], GRID)
    assert len(site) == count


@pytest.mark.parametrize("places", [1, 2, 5, 12])
@pytest.mark.parametrize(("at_once", "moments"), [(True, 1), (True, 3), (False, 2), (False, 3)])
def test_places_of_one_stream_are_sites_of_their_own(places, moments, at_once):
    arclength = np.tile(np.linspace(0.1, 0.5, places), moments)
    time = np.repeat(np.linspace(0.0, 1.0, moments), places)
    if not at_once:
        time = np.linspace(0.0, 1.0, time.size)
    sites = sites_of([_stream(time, arclength)], GRID)
    assert [len(site) for site in sites] == [moments] * places
