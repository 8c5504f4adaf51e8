"""Learnable parameters of a robot file: named groups of its numbers."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.sensors.sensors import sensor_class

Document = dict[str, Any]
"""A robot file as parsed from TOML."""

_PARTS: dict[str, tuple[int, ...]] = {"linear": (0, 1, 2), "bending": (3, 4), "torsion": (5,)}
_HALVES: dict[str, tuple[int, ...]] = {"linear": (0, 1, 2), "angular": (3, 4, 5)}
_STRAINS = ("psd_strain_arclength", "psd_strain_time", "var_strain", "psd_strain")
_JUMPS = ("var_jumps", "psd_jumps")
_RATES = ("psd_velocity_time", "psd_velocity_arclength")
_LOADS = ("psd_load", "psd_strain_error", "var_tip")
_POINTS = "var_points"


@dataclass(frozen=True)
class Parameter:
    """Entries of vectors (or a number) of a robot file that are scaled, or shifted, together.

    Attributes:
        label: Name of the parameter.
        path: Keys of the vector in the document.
        entries: Indices of the entries; empty for a number.
        unit: Unit in which the entries are shifted; None if they are scaled instead.
        likewise: Keys of other vectors whose entries change by the same factor or shift.
    """

    label: str
    path: tuple[str | int, ...]
    entries: tuple[int, ...]
    unit: float | None = None
    likewise: tuple[tuple[str | int, ...], ...] = ()

    def _values(self, document: Document) -> Array:
        paths = (self.path, *self.likewise)
        return np.array([np.take(_follow(document, p), self.entries or 0) for p in paths])

    def of(self, document: Document) -> float:
        """Mean of the entries: geometric if they are scaled."""
        values = self._values(document)
        return float(np.exp(np.mean(np.log(values))) if self.unit is None else np.mean(values))

    def is_sound(self, document: Document) -> bool:
        """Whether all entries are positive, as scaling requires."""
        return self.unit is not None or bool(np.all(self._values(document) > 0.0))

    def move(self, document: Document, x: float) -> None:
        """Multiply the entries of a document by exp(x), or add x units, in place."""
        factor = float(np.exp(x))
        for *way, last in (self.path, *self.likewise):
            parent = _follow(document, way)
            if not self.entries:
                parent[last] = float(parent[last] * factor)
                continue
            vector = parent[last]
            for i in self.entries:
                moved = vector[i] * factor if self.unit is None else vector[i] + x * self.unit
                vector[i] = float(moved)


def _follow(document: Any, path: Sequence[str | int]) -> Any:
    for step in path:
        document = document[step]
    return document


def expanded(document: Document) -> Document:
    """Copy of a document in which every pair [linear, angular] is expanded by component."""
    out = copy.deepcopy(document)
    for table in (out["prior"], out.get("base", {})):
        for key, value in table.items():
            if key in (*_JUMPS, _POINTS) or (
                key == "psd_strain_arclength" and isinstance(value[0], list)
            ):
                table[key] = [_six(row) for row in value]
            elif key.startswith(("psd_", "var_")):
                table[key] = _six(value)
    for kind, sensor in out.get("sensors", {}).items():
        rows = sensor_class(kind).rows
        if rows in (5, 6) and len(sensor["std"]) == 2:
            sensor["std"] = [float(v) for v in np.repeat(sensor["std"], (3, rows - 3))]
    for unknown in out.get("sensor_parameters", []):
        if len(unknown.get("std", [])) == 2:
            unknown["std"] = _six(unknown["std"])
    return out


def _six(value: Sequence[float]) -> list[float]:
    return [float(v) for v in (np.repeat(value, 3) if len(value) == 2 else value)]


def learnable(document: Document, kinds: Sequence[str], *, alike: bool = False) -> list[Parameter]:
    """Learnable parameters of an expanded document.

    Args:
        document: Robot file, see `expanded`.
        kinds: Kinds of the sensors whose noise can be learned.
        alike: Whether all segments share one factor, as segments of equal construction.
    """
    return [p for p in _all(document, kinds, alike) if p.is_sound(document)]


def _all(document: Document, kinds: Sequence[str], alike: bool) -> Iterator[Parameter]:
    prior = document["prior"]
    yield from _rest(document)
    yield from _weights(document)
    if "time_scale" in prior:
        yield Parameter("time scale", ("prior", "time_scale"), ())
    for table in ("prior", "base"):
        for key, value in document.get(table, {}).items():
            name = key.split("_", 1)[-1].replace("_", " ") + (" of the base" * (table == "base"))
            if key in _STRAINS + _JUMPS:
                paths: list[tuple[str | int, ...]] = [(table, key)]
                if isinstance(value[0], list):
                    paths = [(table, key, row) for row in range(len(value))]
                yield from _by_segment(name, paths, alike)
            elif key in _RATES + _LOADS:
                for part, entries in _HALVES.items():
                    yield Parameter(f"{name}, {part}", (table, key), entries)
            elif key == _POINTS:
                for row in range(len(value)):
                    for part, entries in _HALVES.items():
                        yield Parameter(f"{name} {row + 1}, {part}", (table, key, row), entries)
    for kind in dict.fromkeys(kinds):
        size = len(document.get("sensors", {}).get(kind, {}).get("std", []))
        path = ("sensors", kind, "std")
        if size in (5, 6) and kind != "strain":
            yield Parameter(f"{kind} noise, linear", path, (0, 1, 2))
            yield Parameter(f"{kind} noise, angular", path, tuple(range(3, size)))
        elif size:
            yield Parameter(f"{kind} noise", path, tuple(range(size)))
    for i, unknown in enumerate(document.get("sensor_parameters", [])):
        if "correlation_time" in unknown:
            to = ("sensor_parameters", i, "std")
            size = len(unknown["std"])
            halves = _HALVES if size == 6 else {"": tuple(range(size))}
            for part, entries in halves.items():
                yield Parameter(f"{unknown['name']} spread {part}".strip(), to, entries)
            to = ("sensor_parameters", i, "correlation_time")
            yield Parameter(f"{unknown['name']} correlation time", to, ())


def _by_segment(name: str, paths: list[tuple[str | int, ...]], alike: bool) -> Iterator[Parameter]:
    """Bending and torsion of every segment, or of all segments jointly."""
    numbers = [f" {i + 1}" for i in range(len(paths))] if len(paths[0]) > 2 else [""]
    for number, path in [("", paths[0])] if alike else zip(numbers, paths, strict=True):
        for part in ("bending", "torsion"):
            others = tuple(paths[1:]) if alike else ()
            yield Parameter(f"{name}{number}, {part}", path, _PARTS[part], likewise=others)


def _rest(document: Document) -> Iterator[Parameter]:
    """Curvature of the rest shape, if the document states it by segment."""
    for key, unit, label in (
        ("rest_strain", 1.0, "rest curvature"),
        ("rest_slope", 5.0, "rest curvature's slope"),
    ):
        rows = document.get(key, [])
        if rows and isinstance(rows[0], list):
            for row in range(len(rows)):
                for axis, entry in (("x", 3), ("y", 4)):
                    yield Parameter(f"{label} {row + 1}, {axis}", (key, row), (entry,), unit)


def _weights(document: Document) -> Iterator[Parameter]:
    """Masses that bend a rod by weight; the stiffness is fixed, as only ratios are observable."""
    mechanics = document.get("mechanics", {})
    if document["prior"]["kind"] != "mechanical" or not any(mechanics.get("gravity", [])):
        return
    if "mass_per_length" in mechanics:
        rows = tuple(range(np.size(mechanics["mass_per_length"])))
        one = not isinstance(mechanics["mass_per_length"], list)
        yield Parameter("mass per length", ("mechanics", "mass_per_length"), () if one else rows)
    if "mass" in mechanics.get("tip", {}):
        yield Parameter("mass of the tip", ("mechanics", "tip", "mass"), ())


def moved(document: Document, parameters: Sequence[Parameter], x: Array) -> Document:
    """Copy of an expanded document with every parameter moved by its entry of x (P,)."""
    out = copy.deepcopy(document)
    for parameter, value in zip(parameters, x, strict=True):
        parameter.move(out, float(value))
    return out
