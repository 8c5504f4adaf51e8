"""A robot much slower than its prior believes is named, and no other."""

import re

import numpy as np
import pytest

from glissando import CoilReadings, load_robot, se3
from glissando.evaluation.plausibility.examine import examine
from scenes import LENGTH, arc

STD = np.repeat([7e-4, 6e-3], [3, 2])


def coil(*, moves=False, stroke=0.3, duration=12.0):
    """A coil that slides to and fro from the tip, once in 6 s, in an arc that stands or moves."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, duration, 0.025)
    place = LENGTH - stroke * np.abs(np.sin(np.pi / 6.0 * time))
    error = np.zeros((time.size, 6))
    error[:, :5] = STD * rng.standard_normal((time.size, 5))
    error[:, 5] = rng.uniform(-np.pi, np.pi, time.size)
    values = arc(place, time if moves else 1.0) @ se3.exp(error)
    return CoilReadings(time=time, arclength=place, values=values, cov=STD**2, name="coil")


def named(robot, **how):
    return [f for f in examine(load_robot(robot), [coil(**how)]) if f.name == "pace"]


def test_a_robot_that_stands_still_while_a_coil_traverses_it_is_named_with_its_time_scale():
    (finding,) = named("tdcr466-segments")
    assert not finding.refusal
    assert finding.streams == ("coil",)
    given = re.search(r"time_scale = (\S+) in .* time_rate = (\S+) in", finding.sentence)
    scale, rate = map(float, given.groups())
    assert 6.0 < scale <= 12.0
    assert rate == pytest.approx(15.0 / scale, rel=0.05)


@pytest.mark.parametrize(
    ("robot", "how"),
    [
        ("tdcr466-segments", {"moves": True}),
        ("tdcr466-segments", {"stroke": 0.06}),
        ("tdcr466-segments", {"duration": 1.5}),
        ("tdcr466", {}),  # its prior lets a robot at rest stay there
    ],
)
def test_no_robot_is_named_that_moves_or_is_read_at_its_tip_or_is_not_forgotten(robot, how):
    assert not named(robot, **how)
