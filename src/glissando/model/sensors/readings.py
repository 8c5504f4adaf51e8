"""What every sensor shares: a batch of readings, and a derivative for those that have none.

A sensor is a dataclass of readings with a residual, about twenty lines. Subclass `Readings`, set
`rows`, write `residual(at)`; `jacobian(at)` is optional and is otherwise found numerically and
checked. Every reading has its own time and arclength: sliding is the normal case.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.noise import Loss, covariance_matrix
from glissando.model.state import DOF, State

_EACH = ("time", "arclength", "values")


@dataclass(frozen=True, kw_only=True)
class Readings:
    """M readings of one sensor: `time` (M,) s, `arclength` (M,) m, `values` (M, …), `cov`.

    `cov` is a variance, `rows` variances, or a matrix (rows, rows) or (M, rows, rows). `mount`
    (4, 4), or one a reading, is T_bc, the sensor in the cross-section's frame. `loss` forgives
    outliers. `name` is used in messages, and to find the unknowns of a sensor. `arclength_std` (m,
    one or one a reading) is how uncertain the arclength is itself (equation 16). Raises SensorError
    when shapes differ or a value is not finite.
    """

    time: Array
    arclength: Array
    values: Array
    cov: Array
    mount: Array = field(default_factory=lambda: np.eye(4))
    loss: Loss | None = None
    name: str = ""
    arclength_std: Array | float = 0.0

    rows: ClassVar[int]
    value_shape: ClassVar[tuple[int, ...] | None] = None  # of one reading; None: any
    fixes_base: ClassVar[bool] = False
    per_reading: ClassVar[tuple[str, ...]] = ()  # fields of one's own with a row a reading

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
        if mount.shape not in ((4, 4), (*count, 4, 4)):
            raise SensorError(f"{self.label}: mount has shape {mount.shape}; give (4, 4).")
        _require_rotations(f"{self.label} mount", mount.reshape(-1, 4, 4))
        std = np.asarray(self.arclength_std, dtype=float)
        object.__setattr__(self, "arclength_std", std)
        if std.shape not in ((), count) or not np.all(std >= 0.0):
            raise SensorError(f"{self.label}: arclength_std must be one number from 0, or {count}.")
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
        if isinstance(rows, np.ndarray) and rows.dtype == bool and rows.all():
            return self
        kept = {name: getattr(self, name)[rows] for name in (*_EACH, *self.per_reading)}
        for name, single in (("cov", 2), ("mount", 2), ("arclength_std", 0)):
            value = getattr(self, name)
            kept[name] = value[rows] if value.ndim > single else value
        return self.changed(**kept)

    def changed(self, **fields: Array) -> Self:
        """The readings with other fields, taken to be sound: checking would cost more than use."""
        out = object.__new__(type(self))
        out.__dict__.update(self.__dict__, **fields)
        return out

    def joined(self, other: Self) -> Self:
        """These readings, then those of the same sensor."""
        kept = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in (*_EACH, *self.per_reading)
        }
        for name, single in (("cov", 2), ("mount", 2), ("arclength_std", 0)):
            mine, its = getattr(self, name), getattr(other, name)
            alike = mine is its or (mine.shape == its.shape and bool(np.all(mine == its)))
            if mine.ndim == single and alike:
                continue
            both = [
                np.broadcast_to(value, (len(part), *value.shape[value.ndim - single :]))
                for part, value in ((self, mine), (other, its))
            ]
            kept[name] = np.concatenate(both)
        return self.changed(**kept)

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
