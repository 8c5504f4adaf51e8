"""Poses and lengths that peers send: units with prefixes, quaternions of any length, skew."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.hardware.openigtlink import Message
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.address import WireFrame
from glissando.hardware.openigtlink.tracker import is_rigid, normalized, poses_in

METRE, PER_SECOND = 0x01 << 54 | 1 << 50, 0x03 << 44 | 0xF << 40


@pytest.mark.parametrize(
    ("prefix", "metres"),
    [(0x0, 1.0), (0x1, 10.0), (0x2, 100.0), (0x3, 1e3), (0x9, 0.1), (0xA, 1e-2), (0xB, 1e-3),
     (0xC, 1e-6), (0xD, 1e-9)],
)  # fmt: skip
def test_a_length_has_the_prefix_that_it_states(prefix, metres):
    assert WireFrame().length_unit(prefix << 60 | METRE) == metres


@pytest.mark.parametrize("unit", [METRE | PER_SECOND, 0xB << 60, 0x8 << 60 | METRE, 0x02 << 54])
def test_what_is_no_length_is_refused(unit):
    with pytest.raises(DeviceError, match="is not a length; send metres"):
        WireFrame().length_unit(unit)


@pytest.mark.parametrize(
    ("norm", "rigid"), [(1.0, True), (1.001, True), (0.5, False), (2.0, False)]
)
def test_a_quaternion_that_is_none_gives_no_rigid_motion(norm, rigid):
    sent = c.Position(np.array([1.0, 2.0, 3.0]), norm * np.array([0.5, 0.5, 0.5, 0.5]))
    ((_, kind, pose),) = poses_in(Message(sent, "tip"), WireFrame())
    assert kind == "pose"
    assert is_rigid(pose) == rigid


def test_a_skewed_rotation_becomes_the_nearest_one():
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose = se3.exp(rng.standard_normal(6))
        pose[:3, :3] += 1e-3 * rng.standard_normal((3, 3))
        nearest = Rotation.from_matrix(pose[:3, :3]).as_matrix()
        np.testing.assert_allclose(normalized(pose)[:3, :3], nearest, atol=1e-12)
