"""The sensors: the expected value and residual of readings of each kind at a state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glissando._kernels import sensors as kernels
from glissando.errors import SensorError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.accelerometer import AccelerometerReadings as AccelerometerReadings
from glissando.model.sensors.compiled_readings import CompiledReadings
from glissando.model.sensors.given_arrays import numbers, repeats_at_place
from glissando.model.sensors.readings import SENSORS, Readings
from glissando.model.sensors.tendons import TendonReadings as TendonReadings
from glissando.model.state import DOF, STRAIN, State

_WIDEST, _TURN = 0.05, 7.0  # m of a core's radius, rad of its angle
_LONGEST = 1.0  # strain of a core
_POSITION = dict.fromkeys(("x", "y", "z"), "m")
_QUATERNION = dict.fromkeys(("qw", "qx", "qy", "qz"), "1")


def sensor_kinds() -> list[str]:
    """Kinds of sensor by their names in files, custom sensors included."""
    return list(SENSORS)


def sensor_class(kind: str) -> type[Readings]:
    """Class of the sensors of a kind.

    Raises:
        SensorError: No sensor has that kind.
    """
    if kind not in SENSORS:
        raise SensorError(f"{kind!r} is not a kind of sensor; known: {', '.join(SENSORS)}.")
    return SENSORS[kind]


def _columns(block: Array, where: slice) -> Array:
    out = np.zeros((*block.shape[:-1], DOF))
    out[..., where] = block
    return out


class _TrackedPose(CompiledReadings):
    """Base class of trackers that report poses T_wc."""

    columns: ClassVar[Mapping[str, str]] = {**_POSITION, **_QUATERNION}
    value_shape: ClassVar[tuple[int, ...] | None] = (4, 4)
    fixes_base: ClassVar[bool] = True
    tracker: ClassVar[bool] = True

    @classmethod
    def from_columns(cls, table: Array) -> Array:
        """Poses from positions and quaternions [w, x, y, z]."""
        return se3.pose(se3.rotation_from_quaternion(table[:, 3:]), table[:, :3])

    @classmethod
    def to_columns(cls, values: Array) -> Array:
        """Positions and quaternions [w, x, y, z] of poses."""
        return np.hstack([values[:, :3, 3], se3.quaternion(values[:, :3, :3])])

    @classmethod
    def in_frame(cls, values: Array, pose: Array) -> Array:
        """Poses in the world frame."""
        return pose @ values

    @classmethod
    def values_at(cls, pose: Array, **settings: Any) -> Array:
        """The poses themselves."""
        return pose


@dataclass(frozen=True, kw_only=True)
class PoseReadings(_TrackedPose, kind="pose"):
    """A six-degree-of-freedom tracker: `values` (M, 4, 4) poses T_wc. Source: equation (14)."""

    sensor: ClassVar[int] = kernels.POSE
    rows: ClassVar[int] = 6


@dataclass(frozen=True, kw_only=True)
class CoilReadings(_TrackedPose, kind="coil"):
    """A five-degree-of-freedom coil, without roll about its z: `values` (M, 4, 4) poses T_wc.

    The reported roll is arbitrary: the predicted pose is rotated to it before the roll row is
    dropped, so that no roll, of the coil or of the robot about it, affects the other rows. Its
    `cov` (5) should be the same for the coil's x and y. Source: equation (15).
    """

    sensor: ClassVar[int] = kernels.COIL
    rows: ClassVar[int] = 5


@dataclass(frozen=True, kw_only=True)
class PositionReadings(CompiledReadings, kind="position"):
    """Position of a point in the world: `values` (M, 3), in metres. Source: (17)."""

    sensor: ClassVar[int] = kernels.POSITION
    rows: ClassVar[int] = 3
    columns: ClassVar[Mapping[str, str]] = _POSITION
    value_shape: ClassVar[tuple[int, ...] | None] = (3,)
    fixes_base: ClassVar[bool] = True
    tracker: ClassVar[bool] = True

    @classmethod
    def in_frame(cls, values: Array, pose: Array) -> Array:
        """Positions in the world frame."""
        return values @ pose[:3, :3].T + pose[:3, 3]

    @classmethod
    def values_at(cls, pose: Array, **settings: Any) -> Array:
        """Positions of poses."""
        return pose[:, :3, 3]


@dataclass(frozen=True, kw_only=True)
class OrientationReadings(CompiledReadings, kind="orientation"):
    """An orientation in the world: `values` (M, 3, 3) rotations R_wc. Source: (17)."""

    sensor: ClassVar[int] = kernels.ORIENTATION
    rows: ClassVar[int] = 3
    columns: ClassVar[Mapping[str, str]] = _QUATERNION
    value_shape: ClassVar[tuple[int, ...] | None] = (3, 3)
    tracker: ClassVar[bool] = True

    @classmethod
    def from_columns(cls, table: Array) -> Array:
        """Rotations from quaternions [w, x, y, z]."""
        return se3.rotation_from_quaternion(table)

    @classmethod
    def to_columns(cls, values: Array) -> Array:
        """Quaternions [w, x, y, z] of rotations."""
        return se3.quaternion(values)

    @classmethod
    def in_frame(cls, values: Array, pose: Array) -> Array:
        """Rotations in the world frame."""
        return pose[:3, :3] @ values

    @classmethod
    def repeated(cls, values: Array, arclength: Array) -> NDArray[np.bool_]:
        """Mask (M,) of repeats at one place, as a straight robot has one orientation at many."""
        return repeats_at_place(cls.to_columns(values), arclength)

    @classmethod
    def values_at(cls, pose: Array, **settings: Any) -> Array:
        """Rotations of poses."""
        return pose[:, :3, :3]


@dataclass(frozen=True, kw_only=True)
class GyroReadings(CompiledReadings, kind="gyro"):
    """Angular velocity in the sensor's own frame: `values` (M, 3) in rad/s. Source: (17)."""

    sensor: ClassVar[int] = kernels.GYRO
    rows: ClassVar[int] = 3
    columns: ClassVar[Mapping[str, str]] = dict.fromkeys(("wx", "wy", "wz"), "rad/s")
    value_shape: ClassVar[tuple[int, ...] | None] = (3,)


@dataclass(frozen=True, kw_only=True)
class StrainReadings(CompiledReadings, kind="strain"):
    """All six strains of the cross-section: `values` (M, 6), [linear, angular]. Source: (17)."""

    mounted: ClassVar[bool] = False
    resolves_axes: ClassVar[bool] = True
    sensor: ClassVar[int] = kernels.STRAIN
    rows: ClassVar[int] = 6
    columns: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("nu_x", "nu_y", "nu_z"), "1"),
        **dict.fromkeys(("u_x", "u_y", "u_z"), "rad/m"),
    }
    value_shape: ClassVar[tuple[int, ...] | None] = (6,)


@dataclass(frozen=True, kw_only=True)
class FbgReadings(Readings, kind="fbg"):
    """Fibre Bragg grating cores: `values` (M, C) axial strains, dimensionless. Source: (17).

    Core i runs at radius `core_radius[i]` (m) and angle `core_angle[i]` (rad), at
    c = [a cos θ, a sin θ, 0] in the cross-section; a centre core has radius zero.
    """

    core_radius: Array
    core_angle: Array

    mounted: ClassVar[bool] = False
    resolves_axes: ClassVar[bool] = True
    rows: ClassVar[int] = 1  # in a file: one standard deviation for all cores
    settings: ClassVar[Mapping[str, str]] = {"core_radius": "m", "core_angle": "rad"}

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(beyond := np.argwhere(np.abs(self.values) > _LONGEST)):
            row, core = beyond[0]
            raise SensorError(
                f"{self.label}: strain of core {core} in row {row} is {self.values[row, core]:g}, "
                f"and no fibre doubles its length; give strain, 1e-6 times microstrain."
            )

    @classmethod
    def value_columns(cls, settings: Mapping[str, Array]) -> Mapping[str, str]:
        """One strain a core."""
        return {f"strain_{i}": "1" for i in range(np.size(settings["core_radius"]))}

    @property
    def row_count(self) -> int:
        """One row a core."""
        return int(np.size(self.core_radius))

    @property
    def expected_shape(self) -> tuple[int, ...]:
        """One strain a core. Raises SensorError when radii and angles differ in number."""
        if np.ndim(self.core_radius) != 1 or np.shape(self.core_radius) != np.shape(
            self.core_angle
        ):
            raise SensorError(
                f"{self.label}: core radii {np.shape(self.core_radius)} and angles "
                f"{np.shape(self.core_angle)} must be lists of one length; give one of each a core."
            )
        for name, least, most, wanted in (
            ("core_radius", 0.0, _WIDEST, f"metres up to {_WIDEST:g}"),
            ("core_angle", -_TURN, _TURN, "radians of one turn"),
        ):
            value = numbers(self.label, name, getattr(self, name))
            object.__setattr__(self, name, value)
            if not np.all((value >= least) & (value <= most)):
                raise SensorError(f"{self.label}: {name} is {value.tolist()}; give {wanted}.")
        return (len(self.core_radius),)

    def _tangents(self, at: State) -> tuple[Array, Array]:
        """Core tangents ν + u × c (M, C, 3) and core positions c (C, 3)."""
        angle = np.asarray(self.core_angle)
        unit = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        place = np.asarray(self.core_radius)[:, None] * unit
        return at.strain[..., None, :3] + np.cross(at.strain[..., None, 3:], place), place

    def residual(self, at: State) -> Array:
        """Core length per length of backbone, minus one, minus the reading."""
        return np.linalg.norm(self._tangents(at)[0], axis=-1) - 1.0 - self.values

    def jacobian(self, at: State) -> Array:
        """Jacobian (M, C, 18) with the unit tangent t by ν, and c × t by u."""
        tangents, place = self._tangents(at)
        unit = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
        return _columns(np.concatenate([unit, np.cross(place, unit)], axis=-1), STRAIN)
