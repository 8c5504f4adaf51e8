"""The travel in a channel off the axis follows from the shape, and the place from the travel."""

import numpy as np
import pytest

from glissando.errors import RobotFileError, SensorError
from glissando.model.tendons.channel import Channel
from glissando.model.tendons.travel import arclength_of, channel_lengths
from glissando.simulation import Loads, solve_shape
from tendon_robot import LENGTH, simulated, tendon_robot

NODES = np.linspace(0.0, LENGTH, 41)


def travel_of(channel, nodes, strain, arclength):
    """Length of the channel from the base to arclengths of the backbone."""
    places, _, lengths = channel_lengths(channel, nodes, strain)
    return np.interp(arclength, places, lengths)


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0])
def test_inside_a_bend_the_way_is_shorter_by_radius_times_angle(angle):
    channel, curvature = Channel(0.004, angle), 5.0
    strain = np.tile([0.0, 0.0, 1.0, 0.0, curvature, 0.0], (NODES.size, 1))
    travel = travel_of(channel, NODES, strain, NODES)
    expected = NODES * (1.0 - 0.004 * np.cos(angle) * curvature)
    np.testing.assert_allclose(travel, expected, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.inf, 0.15])
def test_in_the_simulators_shape_the_travel_is_the_length_of_the_path_in_space(pitch):
    rod, tendons = simulated(tendon_robot())
    shape = solve_shape(rod, tendons, Loads([1.0, 0.3, 0, 0, 0.8, 0.4]))
    channel, fine = Channel(0.0035, 0.7, pitch), np.linspace(0.0, LENGTH, 4001)
    at = shape.at(fine)
    path = at.pose[:, :3, 3] + np.einsum("mij,mj->mi", at.pose[:, :3, :3], channel.path(fine)[0])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    strain = shape.at(np.linspace(0.0, LENGTH, 401)).strain
    travel = travel_of(channel, np.linspace(0.0, LENGTH, 401), strain, np.array([LENGTH]))
    assert travel[0] == pytest.approx(length, rel=2e-5)
    assert abs(length - LENGTH) > 3e-5


def test_the_place_of_a_travel_is_where_it_was_travelled_to():
    rng = np.random.default_rng(2)
    strain = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (NODES.size, 1))
    strain[:, 3:] += 6.0 * rng.standard_normal(3)
    channel, places = Channel(0.004, 0.3, 0.2), np.sort(rng.uniform(0.0, LENGTH, 9))
    travel = travel_of(channel, NODES, strain, places)
    np.testing.assert_allclose(arclength_of(channel, NODES, strain, travel), places, atol=1e-12)
    with pytest.raises(SensorError, match="A travel of 180 m leaves the channel"):
        arclength_of(channel, NODES, strain, np.array([180.0]))


@pytest.mark.parametrize("pitch", [300.0, -150.0, 50.0])
def test_a_pitch_in_millimetres_is_refused(pitch):
    with pytest.raises(SensorError, match="hardly turns; give metres"):
        Channel(0.004, 0.3, pitch)
    with pytest.raises(RobotFileError, match=r"pitch is .* give metres: 0.3 for 300 mm"):
        tendon_robot(pitch=pitch)
    assert Channel(0.004, 0.3, np.copysign(0.3, pitch)).pitch == np.copysign(0.3, pitch)
