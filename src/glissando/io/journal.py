"""A journal: readings on disk before they are used, as a recording that only grows.

Each call ends with the rows handed to the operating system, so a process that is killed loses none
of them; they are flushed to disk once a second. The result is a recording folder like any other,
with the rows of a stream in order of arrival.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from glissando.errors import RecordingError, SensorError
from glissando.geometry.se3 import Array
from glissando.io.csv_stream import Rows, Stream
from glissando.io.recording_writer import describe_recording, describe_stream
from glissando.model.sensors.readings import SENSORS, Readings

_SYNC = 1.0  # s between flushes to disk


class Journal:
    """Appends readings to a recording folder, new or of an earlier journal.

    Args:
        folder: The folder.
        name: Name of a new recording.

    Raises:
        RecordingError: The folder holds something else.
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
            self._describe(describe_recording(name, journal=True))
        for path in self.folder.glob("*.csv"):
            _cut_unfinished(path)

    def write(self, readings: Readings) -> None:
        """Append readings of one stream, told apart by name.

        Raises:
            SensorError: The sensor declares no kind, the noise or the mount differs from reading to
                reading, or the noise is correlated.
        """
        if not readings.kind:
            raise SensorError(
                f"{readings.label}: a {type(readings).__name__} declares no kind and has no place "
                f"in a recording; use one of {', '.join(c.__name__ for c in SENSORS.values())}."
            )
        named = (*readings.settings, *readings.optional_settings)
        settings = {key: np.asarray(getattr(readings, key)) for key in named}
        at = readings.time, readings.arclength
        rows = Rows(readings.kind, *at, readings.values, {}, settings)
        file = self._files.get(readings.label) or self._begin(readings, rows)
        table = rows.table()
        lines = (",".join(map(repr, row)) for row in table.tolist())
        file.write(("\n".join(lines) + "\n" if len(table) else "").encode())
        file.flush()
        if time.monotonic() - self._synced > _SYNC:
            self.sync()

    def sync(self) -> None:
        """Wait until all of it is on disk."""
        for file in self._files.values():
            os.fsync(file.fileno())
        self._synced = time.monotonic()

    def close(self) -> None:
        """Flush everything and close the files."""
        self.sync()
        for file in self._files.values():
            file.close()
        self._files = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, readings: Readings, rows: Rows) -> BinaryIO:
        """The stream's file, described in recording.toml unless it was before."""
        name = readings.label
        path = self.folder / f"{name}.csv"
        if path.parent != self.folder or not name.isprintable():
            raise SensorError(f"A stream named {name!r} cannot be a file; name it plainly.")
        if not path.exists():
            stream = Stream(name, rows, False, _std(readings), readings.mount, keep_repeats=True)
            described = self._described.read_text(encoding="utf-8") + describe_stream(stream)
            path.write_text(",".join(rows.columns) + "\n", encoding="utf-8")
            self._describe(described)
        self._files[name] = file = path.open("ab")
        return file

    def _describe(self, text: str) -> None:
        """Write recording.toml, whole or not at all."""
        building = self._described.with_suffix(".new")
        building.write_text(text, encoding="utf-8")
        building.replace(self._described)


def _std(readings: Readings) -> Array:
    """The standard deviations of the stream, which must be alike for all of its readings."""
    cov = readings.cov
    if cov.ndim != 2 or np.any(cov != np.diag(np.diagonal(cov))) or readings.mount.ndim != 2:
        raise SensorError(
            f"{readings.label}: a journal keeps one standard deviation a row and one mount for a "
            f"whole stream; give `cov` as variances (rows,)."
        )
    return np.sqrt(np.diagonal(cov))[: readings.rows]


def _cut_unfinished(path: Path) -> None:
    """Cut a last line that was not written to its end."""
    with path.open("rb+") as file:
        text = file.read()
        file.truncate(text.rfind(b"\n") + 1)
