from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from draws import generators, law, motion, poses, prior, sixes, states
from glissando.errors import SensorError
from glissando.estimation.batch import estimate
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.sensors.numerical_jacobian import numerical_jacobian
from glissando.model.sensors.sensors import (
    CoilReadings,
    FbgReadings,
    GyroReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
    Readings,
    StrainReadings,
)
from glissando.model.state import State
from glissando.solver.gauss_newton import SolverOptions

M = 8


def rolled(values, angles):
    roll = np.zeros((len(values), 6))
    roll[:, 5] = angles
    return values @ se3.exp(roll)


def at_zero(sensor, values, count=M, **more):
    """Readings with all times and arclengths zero."""
    zero = np.zeros(count)
    return sensor(time=zero, arclength=zero, values=values, **{"cov": 1e-4, **more})


def coils(rng, at, tilt=0.5):
    mount = poses(rng, reach=0.01)
    seen = at.pose @ mount @ se3.exp(sixes(rng, M, reach=0.02, angle=tilt))
    return at_zero(CoilReadings, rolled(seen, rng.uniform(-np.pi, np.pi, M)), mount=mount)


@law
@given(generators, st.floats(0.0, 2.5))
def test_a_roll_of_the_robot_about_a_coil_changes_no_residual_and_has_no_slope(rng, tilt):
    at = states(rng, M)
    coil = coils(rng, at, tilt)
    about_coil = coil.mount @ rolled(np.tile(np.eye(4), (M, 1, 1)), rng.uniform(-3, 3, M))
    other = replace(at, pose=at.pose @ about_coil @ se3.inverse(coil.mount))
    np.testing.assert_allclose(coil.residual(other), coil.residual(at), rtol=0.0, atol=1e-12)
    axis = se3.adjoint(coil.mount)[:, 5]
    np.testing.assert_allclose(coil.jacobian(at)[..., :6] @ axis, 0.0, atol=1e-12)


@law
@given(generators, st.floats(0.0, 2.5))
def test_any_roll_added_to_coil_readings_turns_the_residual_alone(rng, tilt):
    at = states(rng, M)
    one = coils(rng, at, tilt)
    angle = rng.uniform(-np.pi, np.pi, M)
    other = replace(one, values=rolled(one.values, angle))
    turn = rolled(np.tile(np.eye(4), (M, 1, 1)), -angle)[:, :2, :2]
    for own, its in (
        (one.residual(at)[..., None], other.residual(at)[..., None]),
        (one.jacobian(at), other.jacobian(at)),
    ):
        turned = own.copy()
        turned[:, :2], turned[:, 3:5] = turn @ own[:, :2], turn @ own[:, 3:5]
        np.testing.assert_allclose(its, turned, rtol=0.0, atol=1e-12)


@law
@given(generators)
def test_a_coil_is_a_pose_sensor_of_a_robot_whose_roll_always_agrees(rng):
    at = states(rng, M)
    coil = coils(rng, at)
    apart = se3.inverse(coil.values) @ at.pose @ coil.mount
    agreed = np.arctan2(apart[:, 1, 0] - apart[:, 0, 1], apart[:, 0, 0] + apart[:, 1, 1])
    there = replace(at, pose=rolled(at.pose @ coil.mount, -agreed))
    full = at_zero(PoseReadings, coil.values).residual(there)
    np.testing.assert_allclose(full[:, 5], 0.0, atol=1e-12)
    np.testing.assert_allclose(coil.residual(at), full[:, :5], rtol=0.0, atol=1e-12)


def test_the_roll_of_every_coil_changes_nothing_in_the_estimate():
    rng = np.random.default_rng(40)
    grid = Grid([0.0, 0.2, 0.4], [0.0, 0.1])
    truth = motion(rng, grid, wander=0.01)
    soft = prior(base_pose=truth.pose[0, 0])
    where = {"time": np.repeat(grid.time, 3), "arclength": np.tile(grid.arclength, 2)}
    seen = truth.flatten().pose @ se3.exp(sixes(rng, 6, reach=0.005, angle=0.02))
    found = []
    for roll in (np.zeros(6), rng.uniform(-np.pi, np.pi, 6)):
        coil = CoilReadings(**where, values=rolled(seen, roll), cov=1e-5)
        found.append(
            estimate(soft, grid, [coil], initial=truth, options=SolverOptions(tolerance=0.01))
        )
    one, other = (posterior.at(0.3, 0.05) for posterior in found)
    np.testing.assert_allclose(other.pose, one.pose, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(other.cov, one.cov, rtol=0.0, atol=1e-10 * np.abs(one.cov).max())


@law
@given(generators)
def test_moving_the_world_changes_no_residual(rng):
    at, move = states(rng, M), poses(rng)
    there = State(move @ at.pose, at.strain, at.velocity)
    seen = at.pose @ se3.exp(sixes(rng, M, reach=0.02, angle=0.5))
    point = seen[:, :3, 3]
    pairs = [
        (at_zero(PoseReadings, seen), at_zero(PoseReadings, move @ seen)),
        (at_zero(CoilReadings, seen), at_zero(CoilReadings, move @ seen)),
        (
            at_zero(OrientationReadings, seen[:, :3, :3]),
            at_zero(OrientationReadings, (move @ seen)[:, :3, :3]),
        ),
    ]
    for here, moved in pairs:
        np.testing.assert_allclose(moved.residual(there), here.residual(at), atol=1e-12)
    here = at_zero(PositionReadings, point)
    moved = at_zero(PositionReadings, point @ move[:3, :3].T + move[:3, 3])
    turned = here.residual(at) @ move[:3, :3].T
    np.testing.assert_allclose(moved.residual(there), turned, atol=1e-12)


@law
@given(generators)
def test_a_perfect_reading_has_no_residual(rng):
    at, mount = states(rng, M), poses(rng, reach=0.02)
    pose = at.pose @ mount
    turned = np.einsum("ji,mj->mi", mount[:3, :3], at.velocity[:, 3:])
    for perfect in (
        at_zero(PoseReadings, pose, mount=mount),
        at_zero(CoilReadings, rolled(pose, rng.uniform(-3, 3, M)), mount=mount),
        at_zero(PositionReadings, pose[:, :3, 3], mount=mount),
        at_zero(OrientationReadings, pose[:, :3, :3], mount=mount),
        at_zero(GyroReadings, turned, mount=mount),
        at_zero(StrainReadings, at.strain),
    ):
        np.testing.assert_allclose(perfect.residual(at), 0.0, atol=1e-12)


@law
@given(generators)
def test_grating_cores_stretch_as_the_textbook_says_without_shear(rng):
    at = states(rng, M)
    at.strain[:, :2] = 0.0
    radius, angle = rng.uniform(0.0, 0.01, 4), rng.uniform(-np.pi, np.pi, 4)
    radius[0] = 0.0
    cores = at_zero(FbgReadings, np.zeros((M, 4)), core_radius=radius, core_angle=angle)
    u_x, u_y, u_z = at.strain[:, 3:, None].transpose(1, 0, 2)
    axial = at.strain[:, 2:3] - radius * (u_y * np.cos(angle) - u_x * np.sin(angle))
    expected = np.sqrt(axial**2 + (radius * u_z) ** 2) - 1.0
    np.testing.assert_allclose(cores.residual(at), expected, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(cores.residual(at)[:, 0], at.strain[:, 2] - 1.0, atol=1e-14)


def test_a_core_is_as_long_as_the_curve_it_follows():
    """The stretch of a core on a bent rod, from the length of a polygon through its points."""
    strain, radius, angle = np.array([0.05, -0.1, 1.02, 3.0, -4.0, 5.0]), 0.01, 0.7
    place = np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0, 1.0])
    points = (se3.exp(np.linspace(0.0, 1.0, 20_001)[:, None] * strain) @ place)[:, :3]
    length = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=-1))
    at = State(np.eye(4)[None], strain[None], np.zeros((1, 6)))
    core = at_zero(
        FbgReadings, np.zeros((1, 1)), 1, core_radius=np.r_[radius], core_angle=np.r_[angle]
    )
    np.testing.assert_allclose(core.residual(at), length - 1.0, rtol=0.0, atol=1e-8)


@dataclass(frozen=True, kw_only=True)
class StringReadings(Readings):
    """A string from an anchor in the world to the rod: `values` (M,) lengths."""

    rows: ClassVar[int] = 1
    anchor: np.ndarray

    def residual(self, at):
        """Length of the string minus the reading."""
        reach = at.pose[..., :3, 3] - self.anchor
        return (np.linalg.norm(reach, axis=-1) - self.values)[:, None]


def test_a_sensor_of_fifteen_lines_needs_no_jacobian_of_its_own():
    rng = np.random.default_rng(41)
    at, anchor = states(rng, M), np.array([0.3, -0.2, 5.0])
    string = at_zero(StringReadings, rng.uniform(1.0, 2.0, M), anchor=anchor)
    reach = at.pose[:, :3, 3] - anchor
    unit = reach / np.linalg.norm(reach, axis=-1, keepdims=True)
    expected = np.zeros((M, 1, 18))
    expected[:, 0, :3] = np.einsum("mi,mij->mj", unit, at.pose[:, :3, :3])
    np.testing.assert_allclose(string.jacobian(at), expected, rtol=0.0, atol=1e-9)


def test_a_sensor_of_fifteen_lines_can_be_estimated_with():
    grid, length = Grid([0.0, 0.2, 0.4], [0.0, 0.1]), np.array([0.45, 0.45])
    anchor = np.array([0.3, 0.0, 0.0])
    where = {"time": grid.time, "arclength": np.full(2, 0.4)}
    string = StringReadings(**where, values=length, cov=1e-10, anchor=anchor)
    soft = prior()
    tip = estimate(soft, grid, [string], options=SolverOptions(tolerance=1e-3)).at(0.4, grid.time)
    np.testing.assert_allclose(np.linalg.norm(tip.position - anchor, axis=-1), length, atol=1e-5)


class JumpingReadings(Readings):
    """A residual that jumps by half a unit where the first shear strain is zero."""

    rows = 1

    def residual(self, at):
        """The shear, plus a half where it is positive."""
        return (at.strain[..., 0] + 0.5 * (at.strain[..., 0] > 0.0) - self.values)[:, None]


def test_a_residual_that_jumps_is_refused_by_row():
    at = states(np.random.default_rng(42), M)
    at.strain[:, 0] = 1.0
    jumping = at_zero(JumpingReadings, np.zeros(M), name="whisker")
    assert jumping.jacobian(at)[0, 0, 6] == pytest.approx(1.0)
    at.strain[5, 0] = 2e-5  # nearer to the jump than the longer of the two steps
    with pytest.raises(SensorError, match=r"whisker: .* row 5 is not smooth .* Write"):
        jumping.jacobian(at)


def test_a_sensor_without_a_residual_says_what_to_define():
    class Mute(Readings):
        rows = 1

    at = states(np.random.default_rng(43), M)
    with pytest.raises(NotImplementedError, match=r"Mute must define residual\(at\)"):
        numerical_jacobian(at_zero(Mute, np.zeros(M)), at)


def test_a_field_that_readings_have_not_is_refused():
    at = {"time": np.zeros(1), "arclength": np.zeros(1)}
    coil = CoilReadings(**at, values=np.eye(4)[None], cov=np.ones(5), name="coil")
    with pytest.raises(SensorError, match="coil has no 'tme'"):
        coil.changed(tme=np.ones(1))
