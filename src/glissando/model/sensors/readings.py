"""The base class of all sensors: the declaration of a sensor, and a batch of its readings.

A sensor is a dataclass of readings with a residual, about twenty lines. Subclass `Readings` with a
`kind`, declare `rows` and `columns`, write `residual(at)`; `jacobian(at)` is optional and is
otherwise computed numerically and checked. The class declares all that files, plans and estimators
need of the sensor. Every reading has its own time and arclength, so that any sensor may slide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.noise import Loss, covariance_matrix
from glissando.model.sensors.given_arrays import numbers, repeats_at_place, require_rotations
from glissando.model.sensors.numerical_jacobian import numerical_jacobian
from glissando.model.short_repr import ShortRepr
from glissando.model.state import State
from glissando.model.tendons.channel import Channel

_ROUNDED = 1e-3  # s, rounding of times from which they are refused
_EACH = ("time", "arclength", "values")
_ONE_OR_EACH = (  # fields given once or per reading, and dimensions of one
    *(("cov", 2), ("mount", 2), ("arclength_std", 0), ("slide_speed", 0), ("slide_way", 0)),
)

SENSORS: dict[str, type[Readings]] = {}
"""Sensor classes by kind, in the order of definition; defining a class registers it."""


@dataclass(frozen=True, kw_only=True)
class Readings(ShortRepr):
    """M readings of one sensor, the base class of all sensors.

    A subclass `class Mine(Readings, kind="mine")` declares the sensor: `kind` is its name in
    recordings and robot files; without one it can be estimated with but not recorded. Units of
    columns and settings are m, rad, 1 or quotients such as rad/s, and files may give mm and deg.

    Attributes:
        time: Times (M,), s.
        arclength: Arclengths (M,), m, or one number for a fixed sensor.
        values: Values (M, …), SI units and radians, in the world frame where a frame matters.
        cov: A variance, `rows` variances, or a matrix (rows, rows) or (M, rows, rows).
        mount: Pose T_bc (4, 4), or (M, 4, 4), of the sensor in the cross-section's frame.
        loss: Robust loss against outliers.
        name: The stream's name, in messages and for the sensor parameters that apply to it.
        arclength_std: Standard deviation of the arclength, m, one or (M,) (equation 16).
        channel: The channel beside the backbone that the sensor slides in, along which its
            arclength is measured, from the base; None for a sensor on the backbone.
        beside: For readings located in a channel (M, 2, N, 6): the derivative of their arclength by
            the strain at the arclength nodes, and the strain at which they were located.
        winding: For such readings (M, 6): derivative of the mount by arclength, a twist in the
            cross-section's frame, [linear 1, angular rad/m].
        slide_speed: Rate of a sliding sensor's arclength, m/s, one or (M,).
        slide_way: Direction of its last motion, −1 to 1, one or (M,): see `slide_motion`.
        rows: Declares the residual rows of one reading, and the numbers in a file's `std`.
        columns: Declares the value columns of a CSV file and their units.
        settings: Declares the fields that a whole stream shares, lists of numbers, and their units.
        optional_settings: Declares further such fields, which a recording may leave out.
        spans: Declares that a reading depends on the whole robot at its time: it has
            `residual_over(arclength, at)` and `jacobian_over(arclength, at)` for states (M, N) at
            nodes and places between them instead of `residual` and `jacobian`.
        value_shape: Declares the shape of one reading's value; None for any.
        per_reading: Declares further fields that have one row per reading.
        accelerates: Declares that it needs the state's acceleration: `residual` and `jacobian`
            (M, rows, 24) take an `AcceleratedState`, and are zero for another state.
        mounted: Declares whether `mount` locates the sensor; others have settings for this.
        fixes_base: Declares whether readings determine the robot's pose in the world.
        tracker: Declares a tracker: it may be ground truth, and equal rows are one reading.
        resolves_axes: Declares whether it resolves strain along the axes of the cross-section.

    Raises:
        SensorError: Shapes differ or a value is not finite.
    """

    time: Array
    arclength: Array
    values: Array
    cov: Array
    mount: Array = field(default_factory=lambda: np.eye(4))
    loss: Loss | None = None
    name: str = ""
    arclength_std: Array | float = 0.0
    channel: Channel | None = None
    beside: Array | None = None
    winding: Array | None = None
    slide_speed: Array | float = 0.0
    slide_way: Array | float = 0.0

    kind: ClassVar[str] = ""
    rows: ClassVar[int]
    columns: ClassVar[Mapping[str, str]] = {}
    settings: ClassVar[Mapping[str, str]] = {}
    optional_settings: ClassVar[Mapping[str, str]] = {}
    value_shape: ClassVar[tuple[int, ...] | None] = None
    per_reading: ClassVar[tuple[str, ...]] = ()
    fixes_base: ClassVar[bool] = False
    tracker: ClassVar[bool] = False
    resolves_axes: ClassVar[bool] = False
    mounted: ClassVar[bool] = True
    spans: ClassVar[bool] = False
    accelerates: ClassVar[bool] = False

    def __init_subclass__(cls, *, kind: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.kind = kind
        former = SENSORS.get(kind)
        if former is not None and former.__qualname__ != cls.__qualname__:
            raise SensorError(
                f"Sensor kind {kind!r} is that of {former.__name__}; give {cls.__name__} another."
            )
        if kind:
            SENSORS[kind] = cls

    @classmethod
    def value_columns(cls, settings: Mapping[str, Array]) -> Mapping[str, str]:
        """Value columns and units of a stream with these settings; by default `columns`."""
        return cls.columns

    @classmethod
    def from_columns(cls, table: Array) -> Array:
        """Values (M, …) from the columns (M, C) of a file, in SI units."""
        return table if cls.value_shape is None else table.reshape(len(table), *cls.value_shape)

    @classmethod
    def to_columns(cls, values: Array) -> Array:
        """Columns (M, C) from values (M, …)."""
        return values.reshape(len(values), math.prod(values.shape[1:]))

    @classmethod
    def in_frame(cls, values: Array, pose: Array) -> Array:
        """Values (M, …) of a tracker that stands at `pose` T_wf (4, 4), in the world frame."""
        return values

    @classmethod
    def repeated(cls, values: Array, arclength: Array) -> NDArray[np.bool_]:
        """Mask (M,) of a tracker's readings that repeat the last one, or the last at their place.

        A stream may read several places at once, each of which is compared separately.
        """
        columns = cls.to_columns(values)
        same = np.all(columns[1:] == columns[:-1], axis=1)
        return repeats_at_place(columns, arclength) | np.append(False, same)[: len(values)]

    @classmethod
    def values_at(cls, pose: Array, **settings: Any) -> Array:
        """Noise-free values (M, …) of sensors at poses T_wc (M, 4, 4), for planning.

        Args:
            pose: The poses.
            **settings: The fields that the sensor declares as its settings.

        Raises:
            NotImplementedError: The sensor does not define this and cannot be planned for.
        """
        raise NotImplementedError(f"{cls.__name__} must define values_at(pose) to be planned for.")

    def __post_init__(self) -> None:
        self._require_precise_times()
        for given in ("time", "arclength", "values"):
            array = numbers(self.label, given, getattr(self, given))
            object.__setattr__(self, given, array)
            bad = np.argwhere(~np.isfinite(array))[:, 0] if array.ndim else np.zeros(0, int)
            if bad.size:
                raise SensorError(
                    f"{self.label}: {given} of row {bad[0]} is {array[bad[0]]}; drop that row."
                )
        count = self.time.shape
        if self.arclength.ndim == 0:  # of a fixed sensor
            object.__setattr__(self, "arclength", np.full(count, self.arclength))
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
            require_rotations(self.label, self.values)
        mount = numbers(self.label, "mount", self.mount)
        object.__setattr__(self, "mount", mount)
        if mount.shape not in ((4, 4), (*count, 4, 4)):
            raise SensorError(f"{self.label}: mount has shape {mount.shape}; give (4, 4).")
        require_rotations(f"{self.label} mount", mount.reshape(-1, 4, 4))
        std = numbers(self.label, "arclength_std", self.arclength_std)
        object.__setattr__(self, "arclength_std", std)
        if std.shape not in ((), count) or not np.all((std >= 0.0) & np.isfinite(std)):
            raise SensorError(
                f"{self.label}: arclength_std must be one number from 0, or {count}, all finite."
            )
        for given in ("slide_speed", "slide_way"):
            value = numbers(self.label, given, getattr(self, given))
            object.__setattr__(self, given, value)
            if value.shape not in ((), count) or not np.all(np.isfinite(value)):
                raise SensorError(f"{self.label}: {given} must be one number, or {count}.")
        self._require_effect()
        object.__setattr__(self, "cov", covariance_matrix(self.cov, self.row_count, self.label))
        if self.cov.ndim == 3 and len(self.cov) != len(self):
            raise SensorError(
                f"{self.label}: {len(self.cov)} covariances for {len(self)} readings; give one, "
                f"or one a reading."
            )

    def _require_precise_times(self) -> None:
        """Raise SensorError for times of a type that rounds them by a millisecond or more."""
        time = np.asarray(self.time)
        if time.dtype.kind == "f" and time.dtype.itemsize < 8 and time.size:
            rounded = float(np.spacing(np.abs(time).max()))
            if not rounded < _ROUNDED:
                raise SensorError(
                    f"{self.label}: time is {time.dtype}, which rounds {np.abs(time).max():.6g} s "
                    f"to {rounded:.2g} s; give float64."
                )

    def _require_effect(self) -> None:
        """Raise SensorError for a mount or arclength_std without effect, or an invalid loss."""
        if not self.mounted and self.beside is None and np.any(self.mount != np.eye(4)):
            raise SensorError(
                f"{self.label}: readings of kind {self.kind} have no mount; state where they are "
                f"taken by their own settings, such as the angles of cores."
            )
        if not self.reads_one_state and np.any(self.arclength_std):
            raise SensorError(
                f"{self.label}: an uncertain arclength of readings of kind {self.kind} changes "
                f"nothing; leave arclength_std out."
            )
        if self.loss is not None and (
            isinstance(self.loss, type) or not hasattr(self.loss, "weight")
        ):
            raise SensorError(f"{self.label}: loss is {self.loss!r}; give Huber(3.0) or another.")

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or type(self).__name__

    @property
    def reads_one_state(self) -> bool:
        """Whether a reading depends only on the state at its own arclength and time."""
        return not (self.spans or self.accelerates)

    @property
    def row_count(self) -> int:
        """Residual rows of one reading."""
        return self.rows

    @property
    def expected_shape(self) -> tuple[int, ...] | None:
        """Shape of one reading's value; None for any shape."""
        return self.value_shape

    def __len__(self) -> int:
        return int(self.time.size)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Self:
        """The readings at `rows`, a mask, indices or a slice."""
        if isinstance(rows, np.ndarray) and rows.dtype == bool and rows.all():
            return self
        fields = {name: getattr(self, name)[rows] for name in (*_EACH, *self.per_reading)}
        for name, single in _ONE_OR_EACH:
            value = getattr(self, name)
            fields[name] = value[rows] if value.ndim > single else value
        for name in ("beside", "winding"):
            if getattr(self, name) is not None:
                fields[name] = getattr(self, name)[rows]
        return self.changed(**fields)

    def changed(self, **fields: Any) -> Self:
        """Readings with other fields, which are not checked; `dataclasses.replace` checks.

        Raises:
            SensorError: There is no such field.
        """
        if unknown := fields.keys() - self.__dict__.keys():
            raise SensorError(f"{self.label} has no {min(unknown)!r}; give one of its fields.")
        out = object.__new__(type(self))
        out.__dict__.update(self.__dict__, **fields)
        return out

    def joined(self, other: Self) -> Self:
        """These readings followed by those of `other`, of the same sensor."""
        fields = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in (*_EACH, *self.per_reading)
        }
        for name, single in _ONE_OR_EACH:
            ours, theirs = getattr(self, name), getattr(other, name)
            equal = ours is theirs or (ours.shape == theirs.shape and bool(np.all(ours == theirs)))
            if ours.ndim == single and equal:
                continue
            each = [
                np.broadcast_to(value, (len(part), *value.shape[value.ndim - single :]))
                for part, value in ((self, ours), (other, theirs))
            ]
            fields[name] = np.concatenate(each)
        return self.changed(**fields)

    def inside(self, grid: Grid) -> Self:
        """The readings whose arclength and time lie on the grid."""
        return self.select(grid.contains(self.arclength, self.time))

    def residual(self, at: State) -> Array:
        """Expected minus measured (M, rows) at states `at` (M,), in the units of the reading."""
        raise NotImplementedError(f"{type(self).__name__} must define residual(at).")

    def jacobian(self, at: State) -> Array:
        """∂residual/∂[pose, strain, velocity] (M, rows, 18), poses perturbed on the right."""
        return numerical_jacobian(self, at)

    @property
    def longest_step(self) -> float:
        """Largest distance, m, between the states that `residual_over` takes."""
        return np.inf

    def residual_over(self, arclength: Array, at: State) -> Array:
        """Expected minus measured (M, rows) from states (M, N) at places (N,), if it `spans`."""
        raise NotImplementedError(f"{type(self).__name__} must define residual_over(s, at).")

    def jacobian_over(self, arclength: Array, at: State) -> Array:
        """∂residual/∂[pose, strain, velocity] at the places (M, rows, N, 18), if it `spans`."""
        raise NotImplementedError(f"{type(self).__name__} must define jacobian_over(s, at).")
