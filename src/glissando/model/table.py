"""TOML tables with checked access: errors name the file, the key and the remedy."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.tendons.channel import Channel


class Table:
    """A TOML table with checked access, which records the keys that were not read.

    Every method raises the table's error, which names the file and the key, for a value that is
    missing or wrong.

    Args:
        entries: Keys and values.
        where: File and table, for messages.
        error: Class of the errors to raise.
    """

    def __init__(self, entries: dict[str, Any], where: str, error: type[GlissandoError]) -> None:
        self._unread = dict(entries)
        self._requested: list[str] = []
        self.where = where
        self.error = error

    def fail(self, key: str, problem: str) -> GlissandoError:
        """Error that names the table and the key."""
        return self.error(f"{self.where}: {key} {problem}")

    def _take(self, key: str) -> Any:
        self._requested.append(key)
        return self._unread.pop(key, None)

    def table(self, key: str) -> Table | None:
        """A sub-table, or None when it is absent."""
        if self.peek(key) is not None:
            return self.subtable(key)
        self._take(key)
        return None

    def subtable(self, key: str) -> Table:
        """A required sub-table."""
        value = self._take(key)
        if not isinstance(value, dict):
            problem = "is missing; add this table." if value is None else "must be a table."
            raise self.fail(f"[{key}]", problem)
        return Table(value, f"{self.where} [{key}]", self.error)

    def tables(self, key: str) -> list[Table]:
        """An array of tables, [[key]]; empty when absent."""
        value = self._take(key) or []
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.fail(f"[[{key}]]", "must be an array of tables.")
        where = f"{self.where} [[{key}]]"
        return [Table(v, f"{where} {i}", self.error) for i, v in enumerate(value, start=1)]

    def named_tables(self, key: str) -> list[tuple[str, Table]]:
        """Sub-tables [key.NAME] with their names; empty when absent."""
        outer = self.table(key)
        return [(name, outer.subtable(name)) for name in outer.names()] if outer else []

    def peek(self, key: str) -> Any:
        """Raw value of a key, or None when absent; the key still counts as not read."""
        self._requested.append(key)
        return self._unread.get(key)

    def skip(self, key: str) -> None:
        """Mark a key as read, if another reader checks it."""
        self._take(key)

    def std(self, rows: int) -> Array:
        """`std`: `rows` numbers above zero, or a pair [linear, angular] for six or five."""
        value = self.peek("std")
        if rows == 5 and isinstance(value, list) and len(value) == 2:
            return self.vector("std", 2, positive=True)[[0, 0, 0, 1, 1]]
        return self.vector("std", rows, positive=True)

    def names(self) -> list[str]:
        """Keys that were not read."""
        return list(self._unread)

    def text(self, key: str, default: str | None = None, choices: Iterable[str] = ()) -> str:
        """A string, one of `choices` when they are given."""
        value = self._take(key)
        value = default if value is None else value
        options = list(choices)
        if not isinstance(value, str) or (options and value not in options):
            wanted = f"one of {', '.join(options)}" if options else "a text"
            raise self.fail(key, f"is {_shown(value)}; give {wanted}.")
        return value

    def kind(self, known: Iterable[str]) -> str:
        """The entry `kind`, one of `known`, which a plugin may add to."""
        value = self._take("kind")
        if value not in (kinds := list(known)):
            listed = ", ".join(kinds)
            raise self.fail(
                "kind",
                f"is {_shown(value)}; give one of {listed}, or --plugin FILE that declares it.",
            )
        return str(value)

    def texts(self, key: str) -> list[str]:
        """List of strings, at least one."""
        value = self._take(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
            raise self.fail(key, f"is {_shown(value)}; give a list of texts.")
        return value

    def flag(self, key: str) -> bool:
        """A truth value, false when absent."""
        value = self._take(key)
        if value is not None and not isinstance(value, bool):
            raise self.fail(key, f"is {value!r}; give true or false.")
        return bool(value)

    def number(self, key: str, default: float | None = None, *, positive: bool = True) -> float:
        """A finite number, above zero if `positive`."""
        value = self._take(key)
        value = default if value is None else value
        if value is None or not _is_number(value) or (positive and value <= 0):
            raise self.fail(key, f"is {_shown(value)}; give a number{' above zero' * positive}.")
        return float(value)

    def vector(
        self,
        key: str,
        size: int,
        default: Array | None = None,
        *,
        positive: bool = False,
        pairs: bool = True,
    ) -> Array:
        """`size` finite numbers; six may also be given as a pair [linear, angular] if `pairs`."""
        value = self._take(key)
        if value is None and default is not None:
            return default
        pair = pairs and size == 6 and isinstance(value, list) and len(value) == 2
        if not isinstance(value, list) or not (pair or len(value) == size):
            wanted = f"{size} numbers" + (", or 2 for [linear, angular]" * (pairs and size == 6))
            raise self.fail(key, f"is {_shown(value)}; give {wanted}.")
        if not all(_is_number(v) and (v > 0 or not positive) for v in value):
            raise self.fail(key, f"is {value!r}; give numbers{' above zero' * positive}.")
        return np.repeat(np.array(value, float), 3 if pair else 1)

    def matrix(self, key: str, columns: int) -> Array:
        """Rows of `columns` numbers (R, columns); a single row may be given without its list."""
        value = self._take(key)
        rows = (
            value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
        )
        for row in rows:
            sound = isinstance(row, list) and len(row) == columns and all(map(_is_number, row))
            if not sound:
                raise self.fail(key, f"is {_shown(value)}; give {columns} numbers a row.")
        return np.array(rows, dtype=float)

    def numbers(self, key: str) -> Array:
        """Finite numbers of any count from one."""
        value = self.peek(key)
        if not isinstance(value, list) or not value:
            raise self.fail(key, f"is {_shown(value)}; give a list of numbers.")
        return self.vector(key, len(value), pairs=False)

    def places(self, key: str) -> Array:
        """Arclengths that increase from above 0; empty when absent."""
        places = np.zeros(0) if self.peek(key) is None else self.numbers(key)
        if np.any(np.diff(places, prepend=0.0) <= 0.0):
            raise self.fail(key, "must increase from above 0.")
        return places

    def rows(
        self, key: str, count: int, size: int, *, positive: bool = True, signed: bool = False
    ) -> Array:
        """`count` vectors (count, size), not below zero unless `signed`; pairs as in `vector`."""
        value = self._take(key)
        if not isinstance(value, list) or len(value) != count:
            raise self.fail(key, f"is {_shown(value)}; give {count} rows, [[…], …].")
        out = []
        for row in value:
            entry = Table({key: row}, self.where, self.error)
            out.append(entry.vector(key, size, positive=positive))
            if np.any(out[-1] < 0.0) and not signed:
                raise self.fail(key, f"is {row!r}; give no number below zero.")
        return np.array(out)

    def pose(self) -> Array:
        """`position` and `quaternion` [w, x, y, z] as a pose (4, 4); identity when absent."""
        position = self.vector("position", 3, np.zeros(3))
        q = self.vector("quaternion", 4, np.array([1.0, 0, 0, 0]))
        if abs(np.linalg.norm(q) - 1.0) > 1e-3:
            raise self.fail(
                "quaternion", f"has norm {np.linalg.norm(q):.4g}; give a unit one, [w, x, y, z]."
            )
        return se3.pose(se3.rotation_from_quaternion(q), position)

    def channel(self, length: float = 1.0, angle: float = 1.0) -> Channel | None:
        """`channel`, a table in units of `length` m and `angle` rad; None when absent."""
        table = self.table("channel")
        if table is None:
            return None
        radius, turned = table.number("radius"), table.number("angle", 0.0, positive=False)
        pitch = table.number("pitch", 0.0, positive=False)
        table.close()
        return Channel(length * radius, angle * turned, length * pitch or np.inf)

    def close(self) -> None:
        """Raise unless every key was read: a misspelt key must not be ignored."""
        known = ", ".join(sorted(set(self._requested)))
        for key in self._unread:
            near = difflib.get_close_matches(key, self._requested, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys: {known}."
            raise self.fail(key, f"is not a key of this table; {hint}")


def pose_table(pose: Array) -> dict[str, Any]:
    """Table of a pose (4, 4), in the form that `Table.pose` reads."""
    quaternion = se3.quaternion(pose[:3, :3])
    return {"position": pose[:3, 3].tolist(), "quaternion": quaternion.tolist()}


def _is_number(value: Any) -> bool:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return plain and abs(value) <= sys.float_info.max


def _shown(value: Any) -> str:
    return "missing" if value is None else repr(value)
