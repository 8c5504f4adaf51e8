"""Checks of the fields of model classes, as in robot files: shapes, signs and units."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array

_ROTATION_TOLERANCE = 1e-6  # largest entry of |Rᵀ R − I| of a rotation
_LARGEST_EXTENSION = 10.0  # largest extension of a rest strain
_LARGEST_DISTANCE = 50.0  # m, largest distance of a pose from the origin


def is_number(value: object) -> bool:
    """Whether a value is a real number; infinity is one, NaN is not."""
    return isinstance(value, Real) and value == value


class FieldChecks:
    """Checks of a frozen dataclass: each method converts a field and stores the result.

    Every method raises GlissandoError, which names the class, the field and the value.

    Args:
        model: The dataclass instance under construction.
    """

    def __init__(self, model: Any) -> None:
        self._model = model

    def fail(self, name: str, problem: str) -> GlissandoError:
        """Error that names the class and the field."""
        return GlissandoError(f"{type(self._model).__name__}: {name} {problem}")

    def numbers(
        self, name: str, *shapes: tuple[int, ...], above: float | None = None,
        least: float | None = None,
    ) -> Array:  # fmt: skip
        """Convert a field to an array of finite numbers, a copy, of one of the given shapes.

        Args:
            name: Name of the field.
            shapes: Admissible shapes; −1 stands for any length from 1, () for a scalar.
            above: Bound that every number must exceed, if any.
            least: Smallest admissible number, if any.
        """
        given = getattr(self._model, name)
        try:
            value = np.array(given, dtype=float)  # a copy: the caller may change the original
        except (TypeError, ValueError):
            raise self.fail(name, f"is {given!r}; give numbers.") from None
        if not any(_fits(value.shape, shape) for shape in shapes):
            wanted = " or ".join(_shape_text(shape) for shape in shapes)
            raise self.fail(name, f"has shape {value.shape}; give {wanted}.")
        low = above if above is not None else least
        bad = ~np.isfinite(value)
        if low is not None:
            bad |= (value <= low) if above is not None else (value < low)
        if bad.any():
            wanted = "finite numbers"
            if low is not None:
                wanted += f" above {low:g}" if above is not None else f" from {low:g}"
            raise self.fail(name, f"holds {value[bad].flat[0]:g}; give {wanted}.")
        object.__setattr__(self._model, name, value)
        return value

    def number(self, name: str, *, above: float | None = None, least: float | None = None) -> float:
        """Convert a field to one finite number."""
        value = float(self.numbers(name, (), above=above, least=least))
        object.__setattr__(self._model, name, value)
        return value

    def places(self, name: str) -> Array:
        """Convert a field to arclengths (P,) that increase from above 0, possibly none."""
        given = getattr(self._model, name)
        if np.size(given) == 0:
            object.__setattr__(self._model, name, np.zeros(0))
            return np.zeros(0)
        value = self.numbers(name, (-1,), above=0.0)
        if np.any(np.diff(value) <= 0.0):
            raise self.fail(name, f"is {value.tolist()}; give arclengths that increase, in metres.")
        return value

    def pose(self, name: str) -> Array:
        """Convert a field to a pose (4, 4), in metres."""
        value = self.numbers(name, (4, 4))
        rotation = value[:3, :3]
        orthonormal = np.abs(rotation.T @ rotation - np.eye(3)).max() < _ROTATION_TOLERANCE
        if not orthonormal or np.linalg.det(rotation) < 0.0 or np.any(value[3] != [0, 0, 0, 1]):
            raise self.fail(name, "is not a pose; give a rotation, a position and [0, 0, 0, 1].")
        distance = float(np.linalg.norm(value[:3, 3]))
        if distance > _LARGEST_DISTANCE:
            raise self.fail(
                name, f"lies {distance:g} m from the origin; give metres, not millimetres."
            )
        return value

    def rest(self, segments: int) -> None:
        """Check `rest_strain` of a body (6,) or of its segments: a plausible extension."""
        strain = self.numbers("rest_strain", (6,), (segments, 6))
        wrong = strain[..., 2][(strain[..., 2] <= 0.0) | (strain[..., 2] > _LARGEST_EXTENSION)]
        if wrong.size:
            raise self.fail(
                "rest_strain",
                f"has an extension of {wrong[0]:g}; a straight rod at its own length has "
                f"[0, 0, 1, 0, 0, 0].",
            )

    def segments(self) -> int:
        """Number of segments, from checked `joints`, `psd_strain_arclength` and `jumps`."""
        joints = self.places("joints").size
        psd = self.numbers("psd_strain_arclength", (6,), (joints + 1, 6), above=0.0)
        if np.size(self._model.jumps) or psd.ndim > 1 < len(psd):
            self.numbers("jumps", (joints, 6), least=0.0)
        return joints + 1


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    if len(shape) != len(wanted):
        return False
    return all(a == b or (b == -1 and a) for a, b in zip(shape, wanted, strict=True))


def _shape_text(shape: tuple[int, ...]) -> str:
    return str(shape).replace("-1", "K") if shape else "one number"
