"""Where strain jumps at a joint, what depends on all of the strain counts both of its sides."""

import numpy as np
import pytest

from glissando import CoilReadings, Grid, PoseReadings, estimate
from glissando.errors import RobotFileError
from glissando.estimation.channels import placed
from glissando.geometry import se3
from glissando.io.robot_file import parse_robot
from glissando.model.sensors.tendons import TendonReadings
from glissando.model.table import Table
from glissando.model.tendons.channel import Channel

LENGTH, JOINT, RADIUS = 0.2, 0.1, 0.0045
ANGLE = np.radians([0, 120, 240, 0, 120, 240])
PRIORS = {
    "separable": {
        "time_scale": 1.0,
        "psd_strain_arclength": [[1e-8, 1e-8, 1e-8, 1, 1, 1e-2]] * 2,
        "var_jumps": [[1e-8, 1e-8, 1e-8, 200, 200, 1e-2]],
    },
    "white-noise": {
        "psd_strain_arclength": [[1e-8, 1e-8, 1e-8, 1, 1, 1e-2]] * 2,
        "psd_jumps": [[1e-8, 1e-8, 1e-8, 200, 200, 1e-2]],
        "psd_velocity_arclength": [1e-2, 1e-2],
        "psd_velocity_time": [1e-2, 1e-2],
        "psd_strain_time": [1e-2, 1e-2],
    },
}


def robot(kind, nodes):
    key = "psd" if kind == "white-noise" else "var"
    base = {f"{key}_pose": [1e-10, 1e-10], f"{key}_strain": [1e-8, 1e-8, 1e-8, 100, 100, 1e-2]}
    if kind == "white-noise":
        base["psd_velocity"] = [1e-2, 1e-2]
    document = {
        "length": LENGTH,
        "rest_strain": [0, 0, 1, 0, 0, 0],
        "grid": {"arclength_nodes": nodes, "time_rate": 4.0},
        "base": base,
        "prior": {"kind": kind, "joints": [JOINT], **PRIORS[kind]},
    }
    return parse_robot(Table(document, "two.toml", RobotFileError))


def bends(seed):
    """Curvatures (2, 2) of two segments of constant curvature, rad/m."""
    return np.random.default_rng(seed).uniform(-8.0, 8.0, (2, 2))


def pose(bend, s):
    first, second = np.zeros((2, 6))
    first[2] = second[2] = 1.0
    first[3:5], second[3:5] = bend
    return se3.exp(min(s, JOINT) * first) @ se3.exp(max(s - JOINT, 0.0) * second)


@pytest.mark.parametrize("kind", PRIORS)
@pytest.mark.parametrize("nodes", [3, 5, 9])
@pytest.mark.parametrize("seed", range(3))
def test_tendons_show_a_shape_that_bends_otherwise_beyond_a_joint(kind, nodes, seed):
    bend, end = bends(seed), np.repeat([JOINT, LENGTH], 3)
    shorter = RADIUS * (np.cos(ANGLE) * bend[:, 1:] - np.sin(ANGLE) * bend[:, :1])  # by a metre
    values = np.minimum(end, JOINT) * shorter[0] + np.maximum(end - JOINT, 0.0) * shorter[1]
    pulled = TendonReadings(
        time=[0.0], arclength=[LENGTH], values=values[None], cov=1e-8, radius=np.full(6, RADIUS),
        angle=ANGLE, end=end, name="pulled",
    )  # fmt: skip
    two = robot(kind, nodes)
    found = estimate(two.prior, Grid(two.arclength_nodes, [0.0]), [pulled])
    for s in (JOINT, LENGTH):
        at = found.at(s, 0.0)
        miss = np.linalg.norm(at.position - pose(bend, s)[:3, 3])
        assert miss < 0.1 * np.sqrt(np.trace(at.cov_position_world))
        assert miss < 5e-4


@pytest.mark.parametrize("nodes", [3, 5, 9])
@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_in_a_channel_is_where_both_segments_lead_it(nodes, seed):
    bend, channel, two = bends(seed), Channel(RADIUS, 0.7), robot("separable", nodes)
    seen = np.linspace(0.01, LENGTH, 20)
    poses = PoseReadings(
        time=np.zeros(20), arclength=seen, values=[pose(bend, s) for s in seen], cov=[1e-10] * 6,
        name="seen",
    )  # fmt: skip
    shape = estimate(two.prior, Grid(two.arclength_nodes, [0.0]), [poses])
    where = np.array([0.05, 0.09, 0.11, 0.15, 0.19])
    rate = 1.0 + RADIUS * (bend[:, 0] * np.sin(0.7) - bend[:, 1] * np.cos(0.7))
    travel = np.minimum(where, JOINT) * rate[0] + np.maximum(where - JOINT, 0.0) * rate[1]
    coil = CoilReadings(
        time=np.zeros(5), arclength=travel, values=[pose(bend, s) for s in where],
        cov=np.repeat([4e-7, 4e-5], [3, 2]), channel=channel, name="coil",
    )  # fmt: skip
    np.testing.assert_allclose(placed([coil], shape)[0].arclength, where, atol=1e-6)
