"""Sensors: what a batch of readings expects of the state where it was taken.

A sensor is a dataclass of readings with a residual, about twenty lines. Subclass `Readings`, set
`rows`, write `residual(at)`; `jacobian(at)` is optional and is otherwise found numerically and
checked. Every reading has its own time and arclength: sliding is the normal case.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from glissando import se3
from glissando.errors import SensorError
from glissando.grid import Grid
from glissando.noise import Loss, covariance_matrix
from glissando.se3 import Array
from glissando.state import DOF, POSE, STRAIN, State

_ANGULAR_VELOCITY = slice(15, 18)


@dataclass(frozen=True, kw_only=True)
class Readings:
    """M readings of one sensor: `time` (M,) s, `arclength` (M,) m, `values` (M, …), `cov`.

    `cov` is a variance, `rows` variances, or a matrix (rows, rows) or (M, rows, rows). `mount`
    (4, 4) is T_bc, the sensor in the cross-section's frame. `loss` forgives outliers. `name` is
    used in messages. Raises SensorError when shapes differ or a value is not finite.
    """

    time: Array
    arclength: Array
    values: Array
    cov: Array
    mount: Array = field(default_factory=lambda: np.eye(4))
    loss: Loss | None = None
    name: str = ""

    rows: ClassVar[int]
    value_shape: ClassVar[tuple[int, ...] | None] = None  # of one reading; None: any
    fixes_base: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for given in ("time", "arclength", "values"):
            array = np.asarray(getattr(self, given), dtype=float)
            object.__setattr__(self, given, array)
            bad = np.argwhere(~np.isfinite(array))[:, 0] if array.ndim else np.zeros(0, int)
            if bad.size:
                raise SensorError(
                    f"{self.label}: {given} of row {bad[0]} is {array[bad[0]]}; drop that row."
                )
        count = self.time.shape
        if not count == self.arclength.shape == self.values.shape[:1]:
            raise SensorError(
                f"{self.label}: time {count}, arclength {self.arclength.shape} and values "
                f"{self.values.shape} must share their first length; give one of each a row."
            )
        if self.expected_shape not in (None, self.values.shape[1:]):
            raise SensorError(
                f"{self.label}: values have shape {self.values.shape}; give "
                f"{(*count, *(self.expected_shape or ()))}."
            )
        if self.expected_shape in ((4, 4), (3, 3)):
            _require_rotations(self.label, self.values)
        mount = np.asarray(self.mount, dtype=float)
        object.__setattr__(self, "mount", mount)
        if mount.shape != (4, 4):
            raise SensorError(f"{self.label}: mount has shape {mount.shape}; give (4, 4).")
        _require_rotations(f"{self.label} mount", mount[None])
        object.__setattr__(self, "cov", covariance_matrix(self.cov, self.row_count, self.label))
        if self.cov.ndim == 3 and len(self.cov) != len(self):
            raise SensorError(
                f"{self.label}: {len(self.cov)} covariances for {len(self)} readings; give one, "
                f"or one a reading."
            )

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or type(self).__name__

    @property
    def row_count(self) -> int:
        """Residual rows of one reading."""
        return self.rows

    @property
    def expected_shape(self) -> tuple[int, ...] | None:
        """Shape of one reading's value; None where any will do."""
        return self.value_shape

    def __len__(self) -> int:
        return int(self.time.size)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Self:
        """The readings at `rows`, a mask, indices or a slice."""
        kept = {name: getattr(self, name)[rows] for name in ("time", "arclength", "values")}
        cov = self.cov[rows] if self.cov.ndim == 3 else self.cov
        return replace(self, **kept, cov=cov)

    def inside(self, grid: Grid) -> Self:
        """The readings whose arclength and time lie on the grid."""
        return self.select(grid.contains(self.arclength, self.time))

    def residual(self, at: State) -> Array:
        """Expected minus measured (M, rows), in the units of the reading; `at` (M,) states."""
        raise NotImplementedError(f"{type(self).__name__} must define residual(at).")

    def jacobian(self, at: State) -> Array:
        """∂residual/∂[pose, strain, velocity] (M, rows, 18), poses perturbed on the right."""
        return numerical_jacobian(self, at)


def _require_rotations(label: str, values: Array) -> None:
    """Raise SensorError unless values (M, 4, 4) or (M, 3, 3) are poses or rotations."""
    rotation = values[:, :3, :3]
    gap = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(-1, -2), initial=0)
    sound = (gap <= 1e-3) & (np.linalg.det(rotation) > 0.0)
    if values.shape[-1] == 4:
        sound &= np.all(values[:, 3] == [0.0, 0.0, 0.0, 1.0], axis=-1)
    if not np.all(sound):
        raise SensorError(
            f"{label}: row {int(np.argmin(sound))} is no rigid motion; give rotation matrices "
            f"(orthonormal, right-handed), poses with a last row 0 0 0 1."
        )


def numerical_jacobian(readings: Readings, at: State) -> Array:
    """Central differences of a sensor's residual (M, rows, 18), checked at two step sizes.

    A residual that is constant in pieces has no slope to find; give such a sensor a smooth one.
    Raises SensorError when the two disagree: the residual jumps or is not smooth there.
    """
    found = []
    for step in (1e-5, 4e-5):
        columns = []
        for move in step * np.eye(DOF):
            ahead = readings.residual(at.retract(move))
            columns.append((ahead - readings.residual(at.retract(-move))) / (2.0 * step))
        found.append(np.stack(columns, axis=-1))
    gap = np.abs(found[0] - found[1])
    scale = 1.0 + np.abs(found[0]).max(axis=(-1, -2), keepdims=True)
    if not np.all(gap <= 1e-5 * scale):
        row = int(np.unravel_index(np.argmax(gap / scale), gap.shape)[0])
        raise SensorError(
            f"{readings.label}: the residual of row {row} is not smooth where it was taken "
            f"(difference quotients differ by {gap[row].max():.2g}). Write jacobian(at), or a "
            f"residual without jumps (wrap angles with a logarithm)."
        )
    return found[0]


def _mounted(readings: Readings, at: State) -> tuple[Array, Array]:
    """Pose T_wc (M, 4, 4) of the sensor and Ad(T_bc⁻¹) (6, 6), which takes body to sensor."""
    return at.pose @ readings.mount, se3.adjoint(se3.inverse(readings.mount))


def _columns(block: Array, where: slice) -> Array:
    out = np.zeros((*block.shape[:-1], DOF))
    out[..., where] = block
    return out


@dataclass(frozen=True, kw_only=True)
class PoseReadings(Readings):
    """A six-degree-of-freedom tracker: `values` (M, 4, 4) poses T_wc. Source: equation (14)."""

    rows: ClassVar[int] = 6
    value_shape: ClassVar[tuple[int, ...] | None] = (4, 4)
    fixes_base: ClassVar[bool] = True

    def residual(self, at: State) -> Array:
        """log(T_meas⁻¹ T T_bc), [linear, angular] in the sensor's frame."""
        return se3.log(se3.inverse(self.values) @ _mounted(self, at)[0])

    def jacobian(self, at: State) -> Array:
        """J_r⁻¹(e) Ad(T_bc⁻¹) on the pose."""
        to_sensor = _mounted(self, at)[1]
        return _columns(se3.right_jacobian_inverse(self.residual(at)) @ to_sensor, POSE)


@dataclass(frozen=True, kw_only=True)
class CoilReadings(Readings):
    """A five-degree-of-freedom coil, roll about its z unseen: `values` (M, 4, 4) poses T_wc.

    The reported roll is arbitrary and is turned to agree with the prediction before the roll row
    is dropped, so that no roll however large leaks into the other rows. Its `cov` (5) should treat
    the coil's x and y alike. Source: equation (15).
    """

    rows: ClassVar[int] = 5
    value_shape: ClassVar[tuple[int, ...] | None] = (4, 4)
    fixes_base: ClassVar[bool] = True

    def _error(self, at: State) -> Array:
        apart = se3.inverse(self.values) @ _mounted(self, at)[0]
        q = se3.quaternion(apart[..., :3, :3])
        roll = np.zeros((*q.shape[:-1], 6))
        roll[..., 5] = -2.0 * np.arctan2(q[..., 3], q[..., 0])
        return se3.log(se3.exp(roll) @ apart)

    def residual(self, at: State) -> Array:
        """First five components of log(T_rolled⁻¹ T T_bc); the sixth is zero by construction."""
        return self._error(at)[..., :5]

    def jacobian(self, at: State) -> Array:
        """The pose's Jacobian less the roll that follows it."""
        error = self._error(at)
        full = se3.right_jacobian_inverse(error) @ _mounted(self, at)[1]
        by_roll = se3.left_jacobian_inverse(error)[..., :, 5]
        follow = full[..., 5:, :] / by_roll[..., 5, None, None]
        return _columns(full[..., :5, :] - by_roll[..., :5, None] * follow, POSE)


@dataclass(frozen=True, kw_only=True)
class PositionReadings(Readings):
    """A point seen in the world: `values` (M, 3) positions in metres. Source: (17)."""

    rows: ClassVar[int] = 3
    value_shape: ClassVar[tuple[int, ...] | None] = (3,)
    fixes_base: ClassVar[bool] = True

    def residual(self, at: State) -> Array:
        """Position of the sensor minus the reading, world frame."""
        return _mounted(self, at)[0][..., :3, 3] - self.values

    def jacobian(self, at: State) -> Array:
        """R_wc times the linear half of Ad(T_bc⁻¹)."""
        pose, to_sensor = _mounted(self, at)
        return _columns(pose[..., :3, :3] @ to_sensor[:3], POSE)


@dataclass(frozen=True, kw_only=True)
class OrientationReadings(Readings):
    """An orientation in the world: `values` (M, 3, 3) rotations R_wc. Source: (17)."""

    rows: ClassVar[int] = 3
    value_shape: ClassVar[tuple[int, ...] | None] = (3, 3)

    def residual(self, at: State) -> Array:
        """log(R_measᵀ R_wc), a rotation vector in radians."""
        rotation = _mounted(self, at)[0][..., :3, :3]
        return se3.so3_log(np.swapaxes(self.values, -1, -2) @ rotation)

    def jacobian(self, at: State) -> Array:
        """The angular block of J_r⁻¹ times the mount's rotation."""
        turn = np.zeros((len(self), 6))
        turn[:, 3:] = self.residual(at)
        spread = se3.right_jacobian_inverse(turn)[..., 3:, 3:]
        return _columns(spread @ _mounted(self, at)[1][3:], POSE)


@dataclass(frozen=True, kw_only=True)
class GyroReadings(Readings):
    """Angular velocity in the sensor's own frame: `values` (M, 3) in rad/s. Source: (17)."""

    rows: ClassVar[int] = 3
    value_shape: ClassVar[tuple[int, ...] | None] = (3,)

    def residual(self, at: State) -> Array:
        """R_bcᵀ times the body's angular velocity, minus the reading."""
        return at.velocity[..., 3:] @ self.mount[:3, :3] - self.values

    def jacobian(self, at: State) -> Array:
        """R_bcᵀ on the angular velocity."""
        turn = np.broadcast_to(self.mount[:3, :3].T, (len(self), 3, 3))
        return _columns(turn, _ANGULAR_VELOCITY)


@dataclass(frozen=True, kw_only=True)
class StrainReadings(Readings):
    """All six strains of the cross-section: `values` (M, 6), [linear, angular]. Source: (17)."""

    rows: ClassVar[int] = 6
    value_shape: ClassVar[tuple[int, ...] | None] = (6,)

    def residual(self, at: State) -> Array:
        """Strain minus the reading."""
        return at.strain - self.values

    def jacobian(self, at: State) -> Array:
        """Identity on the strain."""
        return _columns(np.broadcast_to(np.eye(6), (len(self), 6, 6)), STRAIN)


@dataclass(frozen=True, kw_only=True)
class FbgReadings(Readings):
    """Fibre Bragg grating cores: `values` (M, C) axial strains, dimensionless. Source: (17).

    Core i runs at radius `core_radius[i]` (m) and angle `core_angle[i]` (rad), at
    c = [a cos θ, a sin θ, 0] in the cross-section; a centre core has radius zero.
    """

    core_radius: Array
    core_angle: Array

    @property
    def row_count(self) -> int:
        """One row a core."""
        return len(self.core_radius)

    @property
    def expected_shape(self) -> tuple[int, ...]:
        """One strain a core. Raises SensorError when radii and angles differ in number."""
        if len(self.core_radius) != len(self.core_angle):
            raise SensorError(
                f"{self.label}: {len(self.core_radius)} core radii and {len(self.core_angle)} "
                f"core angles; give one of each a core."
            )
        return (len(self.core_radius),)

    def _tangents(self, at: State) -> tuple[Array, Array]:
        """Core tangents ν + u × c (M, C, 3) and places c (C, 3)."""
        angle = np.asarray(self.core_angle)
        unit = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        place = np.asarray(self.core_radius)[:, None] * unit
        return at.strain[..., None, :3] + np.cross(at.strain[..., None, 3:], place), place

    def residual(self, at: State) -> Array:
        """Core length per length of backbone, minus one, minus the reading."""
        return np.linalg.norm(self._tangents(at)[0], axis=-1) - 1.0 - self.values

    def jacobian(self, at: State) -> Array:
        """Unit tangent t on ν, and c × t on u."""
        tangents, place = self._tangents(at)
        unit = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
        return _columns(np.concatenate([unit, np.cross(place, unit)], axis=-1), STRAIN)


ROWS = {
    "pose": 6, "coil": 5, "position": 3, "orientation": 3, "gyro": 3, "strain": 6, "fbg": 1
}  # fmt: skip
"""Kinds of sensor by the name files use, and how many standard deviations each takes."""
