"""Numbers of a robot file that can be learned: named, scaled as wholes, always above zero."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from glissando.se3 import Array

Document = dict[str, Any]
"""A robot file as TOML gives it."""

_PARTS: dict[str, tuple[int, ...]] = {"linear": (0, 1, 2), "bending": (3, 4), "torsion": (5,)}
_HALVES: dict[str, tuple[int, ...]] = {"linear": (0, 1, 2), "angular": (3, 4, 5)}
_STRAINS = ("psd_strain_arclength", "psd_strain_time", "var_strain", "psd_strain")
_JUMPS = ("var_jumps", "psd_jumps")
_RATES = ("psd_velocity_time", "psd_velocity_arclength")


@dataclass(frozen=True)
class Parameter:
    """Entries of one vector (or a number) of a robot file that are scaled, or shifted, together.

    `path` leads to the vector, `entries` are those of it that are meant, none for a number. With a
    `unit` they are shifted by so much, and may have either sign.
    """

    label: str
    path: tuple[str | int, ...]
    entries: tuple[int, ...]
    unit: float | None = None

    def of(self, document: Document) -> float:
        """The number, or the mean of the entries: geometric where they are scaled."""
        value = _follow(document, self.path)
        if self.unit is not None:
            return float(np.mean(np.take(value, self.entries)))
        return float(np.exp(np.mean(np.log(np.take(value, self.entries or 0)))))

    def is_sound(self, document: Document) -> bool:
        """Whether all entries are above zero, as what is scaled must be."""
        value = np.take(_follow(document, self.path), self.entries or 0)
        return self.unit is not None or bool(np.all(value > 0.0))

    def move(self, document: Document, x: float) -> None:
        """Multiply the entries by exp(x), or add x units, in place."""
        factor = float(np.exp(x))
        parent = _follow(document, self.path[:-1])
        if not self.entries:
            parent[self.path[-1]] = float(parent[self.path[-1]] * factor)
            return
        vector = parent[self.path[-1]]
        for i in self.entries:
            moved = vector[i] * factor if self.unit is None else vector[i] + x * self.unit
            vector[i] = float(moved)


def _follow(document: Any, path: Sequence[str | int]) -> Any:
    for step in path:
        document = document[step]
    return document


def expanded(document: Document) -> Document:
    """A copy with every pair [linear, angular] written out, so that parts can be told apart."""
    out = copy.deepcopy(document)
    for table in (out["prior"], out.get("base", {})):
        for key, value in table.items():
            if key in _JUMPS or (key == "psd_strain_arclength" and isinstance(value[0], list)):
                table[key] = [_six(row) for row in value]
            elif key.startswith(("psd_", "var_")):
                table[key] = _six(value)
    for kind, sensor in out.get("sensors", {}).items():
        if len(sensor["std"]) == 2:
            each = (3, 2) if kind == "coil" else (3, 3)
            sensor["std"] = [float(v) for v in np.repeat(sensor["std"], each)]
    for unknown in out.get("unknowns", []):
        if len(unknown.get("std", [])) == 2:
            unknown["std"] = _six(unknown["std"])
    return out


def _six(value: Sequence[float]) -> list[float]:
    return [float(v) for v in (np.repeat(value, 3) if len(value) == 2 else value)]


def learnable(document: Document, kinds: Sequence[str]) -> list[Parameter]:
    """What of an expanded document may be learned from sensors of these kinds."""
    return [p for p in _all(document, kinds) if p.is_sound(document)]


def _all(document: Document, kinds: Sequence[str]) -> Iterator[Parameter]:
    prior = document["prior"]
    yield from _rest(document)
    if "time_scale" in prior:
        yield Parameter("time scale", ("prior", "time_scale"), ())
    for table in ("prior", "base"):
        for key, value in document.get(table, {}).items():
            name = key.split("_", 1)[-1].replace("_", " ") + (" of the base" * (table == "base"))
            if key in _STRAINS + _JUMPS:
                rows = range(len(value)) if isinstance(value[0], list) else [None]
                for row in rows:
                    for part in ("bending", "torsion"):
                        where = "" if row is None else f" {row + 1}"
                        to = (table, key, *([] if row is None else [row]))
                        yield Parameter(f"{name}{where}, {part}", to, _PARTS[part])
            elif key in _RATES:
                for part, entries in _HALVES.items():
                    yield Parameter(f"{name}, {part}", (table, key), entries)
    for kind in dict.fromkeys(kinds):
        size = len(document.get("sensors", {}).get(kind, {}).get("std", []))
        path = ("sensors", kind, "std")
        if size in (5, 6) and kind != "strain":
            yield Parameter(f"{kind} noise, linear", path, (0, 1, 2))
            yield Parameter(f"{kind} noise, angular", path, tuple(range(3, size)))
        elif size:
            yield Parameter(f"{kind} noise", path, tuple(range(size)))
    for i, unknown in enumerate(document.get("unknowns", [])):
        if "correlation_time" in unknown:
            to = ("unknowns", i, "std")
            size = len(unknown["std"])
            halves = _HALVES if size == 6 else {"": tuple(range(size))}
            for part, entries in halves.items():
                yield Parameter(f"{unknown['name']} spread {part}".strip(), to, entries)


def _rest(document: Document) -> Iterator[Parameter]:
    """Curvature of the shape at rest, where it is given by segment."""
    for key, unit, label in (
        ("rest_strain", 1.0, "rest curvature"),
        ("rest_slope", 5.0, "rest curvature's slope"),
    ):
        rows = document.get(key, [])
        if rows and isinstance(rows[0], list):
            for row in range(len(rows)):
                for axis, entry in (("x", 3), ("y", 4)):
                    yield Parameter(f"{label} {row + 1}, {axis}", (key, row), (entry,), unit)


def moved(document: Document, parameters: Sequence[Parameter], x: Array) -> Document:
    """A copy of an expanded document with every parameter moved by its number."""
    out = copy.deepcopy(document)
    for parameter, value in zip(parameters, x, strict=True):
        parameter.move(out, float(value))
    return out
