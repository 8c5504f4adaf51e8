"""A journal: readings on disk before they are used, as a recording that only grows.

Each call ends with the rows handed to the operating system, so a process that is killed loses none
of them; the disk is told to keep them once a second. What is left is a recording folder like any
other, whose streams stand in order of arrival.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from glissando.errors import RecordingError, SensorError
from glissando.io import recording_toml
from glissando.io.csv_stream import Rows, columns_of, table_of
from glissando.io.recording import KINDS
from glissando.model.sensors.readings import Readings

_SYNC = 1.0  # s between asking the disk to keep what it has


class Journal:
    """Appends readings to a recording folder, new or left by a journal before.

    A new one is called `name`. Raises RecordingError for a folder that holds something else.
    """

    def __init__(self, folder: str | Path, name: str = "journal") -> None:
        self.folder = Path(folder)
        self._described = self.folder / "recording.toml"
        self._files: dict[str, BinaryIO] = {}
        self._synced = time.monotonic()
        if self.folder.exists() and not self.folder.is_dir():
            raise RecordingError(f"{self.folder} is no folder; give the journal another one.")
        if not self._described.exists():
            if self.folder.exists() and any(self.folder.iterdir()):
                raise RecordingError(
                    f"{self.folder} holds something else; give the journal a new folder."
                )
            self.folder.mkdir(parents=True, exist_ok=True)
            self._describe(recording_toml.head(name, journal=True))
        for path in self.folder.glob("*.csv"):
            _cut_unfinished(path)

    def write(self, readings: Readings) -> None:
        """Append readings of one stream, told apart by name.

        Raises SensorError for a kind that recordings do not have, and for noise or a mount that
        differs from reading to reading, or noise that is correlated.
        """
        kind = next((k for k, cls in KINDS.items() if type(readings) is cls), None)
        if kind is None:
            raise SensorError(
                f"{readings.label}: a {type(readings).__name__} has no place in a recording; use "
                f"one of {', '.join(cls.__name__ for cls in KINDS.values())}."
            )
        file = self._files.get(readings.label) or self._begin(readings, kind)
        table = table_of(Rows(kind, readings.time, readings.arclength, readings.values, {}))
        lines = (",".join(map(repr, row)) for row in table.tolist())
        file.write(("\n".join(lines) + "\n" if len(table) else "").encode())
        file.flush()
        if time.monotonic() - self._synced > _SYNC:
            self.sync()

    def sync(self) -> None:
        """Wait until the disk has all of it."""
        for file in self._files.values():
            os.fsync(file.fileno())
        self._synced = time.monotonic()

    def close(self) -> None:
        """Keep everything and close the files."""
        self.sync()
        for file in self._files.values():
            file.close()
        self._files = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, readings: Readings, kind: str) -> BinaryIO:
        """The stream's file, described in recording.toml unless it was before."""
        name = readings.label
        path = self.folder / f"{name}.csv"
        if path.parent != self.folder or not name.isprintable():
            raise SensorError(f"A stream named {name!r} cannot be a file; name it plainly.")
        if not path.exists():
            described = self._described.read_text(encoding="utf-8")
            columns = columns_of(kind, readings.values.reshape(len(readings), -1).shape[1])
            path.write_text(",".join(["time", "arclength", *columns]) + "\n", encoding="utf-8")
            self._describe(described + _entry(readings, kind))
        self._files[name] = file = path.open("ab")
        return file

    def _describe(self, text: str) -> None:
        """Write recording.toml, whole or not at all."""
        building = self._described.with_suffix(".new")
        building.write_text(text, encoding="utf-8")
        building.replace(self._described)


def _entry(readings: Readings, kind: str) -> str:
    """What recording.toml says of the stream."""
    cov = readings.cov
    if cov.ndim != 2 or np.any(cov != np.diag(np.diagonal(cov))) or readings.mount.ndim != 2:
        raise SensorError(
            f"{readings.label}: a journal keeps one standard deviation a row and one mount for a "
            f"whole stream; give `cov` as variances (rows,)."
        )
    std = np.sqrt(np.diagonal(cov))
    fields = {"name": readings.label, "kind": kind, "keep_repeats": True}
    if kind == "fbg":
        fields |= {k: np.asarray(getattr(readings, k)) for k in ("core_radius", "core_angle")}
    return recording_toml.stream(
        {**fields, "std": std[:1] if kind == "fbg" else std}, readings.mount
    )


def _cut_unfinished(path: Path) -> None:
    """Cut a last line that was not written to its end."""
    with path.open("rb+") as file:
        text = file.read()
        file.truncate(text.rfind(b"\n") + 1)
