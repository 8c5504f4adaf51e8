"""Shapes bent by more than half a turn are found, or what contradicts itself says so."""

import tomllib
import warnings

import numpy as np
import pytest

from glissando import Grid, PoseReadings, estimate, estimate_static
from glissando.errors import FalseConfidenceWarning, GlissandoError
from glissando.geometry import se3
from glissando.io.robot_file import parse_robot
from glissando.io.robot_template import RobotOutline, robot_text
from glissando.model.table import Table

LENGTH, COUNT = 0.466, 24


def robot(bend):
    """The file of a new robot of one segment that bends so far."""
    text = robot_text(RobotOutline("arc", LENGTH, 1, 0.012, bend, ["pose"]))
    return parse_robot(Table(tomllib.loads(text), "arc", GlissandoError))


def arcs(rng, least, most):
    """Strains (S, 6) of circular arcs in any direction."""
    turn, way = rng.uniform(least, most, COUNT), rng.uniform(0.0, 2.0 * np.pi, COUNT)
    zero = np.zeros(COUNT)
    bend = turn / LENGTH * np.array([np.cos(way), np.sin(way)])
    return np.stack([zero, zero, zero + 1.0, *bend, zero], axis=1)


def tips(rng, strain, std):
    """Readings of the tips, their time the number of the shape."""
    noise = std * rng.standard_normal((COUNT, 6))
    values = se3.exp(LENGTH * strain) @ se3.exp(noise)
    at = np.full(COUNT, LENGTH)
    return PoseReadings(time=np.arange(COUNT), arclength=at, values=values, cov=std**2, name="tip")


def test_arcs_of_up_to_three_quarters_of_a_turn_are_found_from_the_tip_alone():
    arc, rng = robot(1.5 * np.pi), np.random.default_rng(0)
    strain = arcs(rng, 0.9 * np.pi, 1.5 * np.pi)
    tip = tips(rng, strain, arc.sensor_std["pose"])
    together = estimate_static(arc.prior, arc.arclength_nodes, [tip])
    for k in range(COUNT):
        one = tip.select(tip.time == k).changed(time=np.zeros(1))
        alone = estimate(arc.prior, Grid(arc.arclength_nodes, [0.0]), [one])
        assert not alone.solve.doubt
        middle = se3.exp(0.5 * LENGTH * strain[k])[:3, 3]
        for found in (alone.at(0.5 * LENGTH, 0.0), together.at(0.5 * LENGTH, k)):
            off = found.position - middle
            assert off @ np.linalg.solve(found.position_covariance(), off) < 25.0
    assert together.converged.all()


@pytest.mark.parametrize(("bend", "doubtful"), [(0.2 * np.pi, True), (np.pi, False)])
def test_a_shape_that_bends_far_more_than_its_file_says_contradicts_it(bend, doubtful):
    arc, rng = robot(bend), np.random.default_rng(1)
    tip = tips(rng, arcs(rng, 0.8 * np.pi, np.pi), arc.sensor_std["pose"])
    one = tip.select(tip.time == 0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FalseConfidenceWarning)
        found = estimate(arc.prior, Grid(arc.arclength_nodes, [0.0]), [one])
    assert bool(found.solve.doubt) == bool(caught) == doubtful
