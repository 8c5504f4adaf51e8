"""The design study: its numbers of one path agree with one another."""

import pytest

from glissando.planning import Trace, Zone, sweep
from plans import LENGTH, ROBOTS


@pytest.mark.parametrize("kind", ROBOTS)
@pytest.mark.parametrize("stroke", [0.06, 0.2])
def test_the_trace_of_one_zone_is_the_square_of_its_deviation(kind, stroke):
    zone = Zone((0.45, 0.55))
    (design,) = sweep(
        ROBOTS[kind],
        [zone],
        strokes=[stroke],
        speeds=[0.05],
        rates=[10.0],
        coils=[1],
        acceleration=0.2,
        upper=LENGTH,
        objective=Trace(),
        horizon=2.0,
    )
    assert design.value == pytest.approx(design.std[0] ** 2, rel=1e-9)
