"""A journal of readings: a recording folder to which rows are appended as they arrive.

Each call hands its rows to the operating system before it returns, so that a killed process loses
none of them; they are flushed to disk once a second. The result is a recording folder like any
other, with the rows of a stream in order of arrival.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from glissando.errors import RecordingError, SensorError
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_text
from glissando.io.csv_stream import Rows, Stream
from glissando.io.plain_file import file_stem
from glissando.io.recording_writer import describe_recording, describe_stream, named_in
from glissando.io.toml_table import read_toml
from glissando.model.robot import Robot
from glissando.model.sensors.readings import SENSORS, Readings

try:
    import fcntl
except ImportError:  # Windows: two programs may write to one folder
    fcntl = None  # type: ignore[assignment]

_SYNC = 1.0  # s between flushes to disk


class Journal:
    """Append readings to a recording folder, new or of an earlier journal.

    Args:
        folder: Folder of the recording.
        name: Name of a new recording.
        robot: Robot of a new recording; its file is copied into the folder unless it is shipped.

    Raises:
        RecordingError: The folder holds something else, or another program writes to it.
    """

    def __init__(
        self, folder: str | Path, name: str = "journal", robot: Robot | None = None
    ) -> None:
        self.folder = Path(folder)
        self._described = self.folder / "recording.toml"
        self._files: dict[str, BinaryIO] = {}
        self._stated: dict[str, tuple[Array, Array]] = {}  # noise and mount of each stream
        self._synced = time.monotonic()
        if self.folder.exists() and not self.folder.is_dir():
            raise RecordingError(f"{self.folder} is not a folder; give the journal another one.")
        if not self._described.exists():
            if self.folder.exists() and any(self.folder.iterdir()):
                raise RecordingError(
                    f"{self.folder} holds something else; give the journal a new folder."
                )
            self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = _lock_folder(self.folder)
        try:
            if not self._described.exists():
                named = named_in(self.folder, robot.file) if robot and robot.file else ""
                self._describe(describe_recording(name, named, journal=True))
            self._kinds = self._read_description()
            for path in self.folder.glob("*.csv"):
                _remove_unfinished_line(path)
        except BaseException:
            self._unlock()
            raise

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the recorded streams."""
        return tuple(self._kinds)

    def write(self, readings: Readings) -> None:
        """Append readings to the stream of their name.

        Raises:
            SensorError: The sensor declares no kind or another one than the stream, the noise or
                the mount differs between readings, or the noise is correlated.
            RecordingError: Writing to disk failed; readings written before are kept.
        """
        if not readings.kind:
            raise SensorError(
                f"{readings.label}: a {type(readings).__name__} declares no kind and has no place "
                f"in a recording; use one of {', '.join(c.__name__ for c in SENSORS.values())}."
            )
        kind = self._kinds.get(readings.label, readings.kind)
        if kind != readings.kind:
            raise SensorError(
                f"{readings.label}: its readings in {self.folder} are of kind {kind!r} and those "
                f"that came now of kind {readings.kind!r}; give each kind a name of its own."
            )
        named = (*readings.settings, *readings.optional_settings)
        settings = {key: np.asarray(getattr(readings, key)) for key in named}
        at = readings.time, readings.arclength
        rows = Rows(readings.kind, *at, readings.values, {}, settings)
        std, mount = _std(readings), readings.mount
        stated = self._stated.setdefault(readings.label, (std, mount))
        if not all(map(_nearly_equal, stated, (std, mount))):
            raise SensorError(
                f"{readings.label}: its noise or mount is not that of the readings before, "
                f"which stands in recording.toml; give these readings a name of their own."
            )
        table = rows.table()
        lines = (",".join(map(repr, row)) for row in table.tolist())
        with self._naming_the_folder():
            file = self._files.get(readings.label) or self._open_stream(readings, rows)
            file.write(("\n".join(lines) + "\n" if len(table) else "").encode())
            file.flush()
        if time.monotonic() - self._synced > _SYNC:
            self.sync()

    def sync(self) -> None:
        """Flush all files to disk and wait until that is done.

        Raises:
            RecordingError: Writing to disk failed.
        """
        with self._naming_the_folder():
            for file in self._files.values():
                os.fsync(file.fileno())
        self._synced = time.monotonic()

    def close(self) -> None:
        """Flush everything and close the files.

        Raises:
            RecordingError: Writing to disk failed.
        """
        try:
            self.sync()
        finally:
            for file in self._files.values():
                with suppress(OSError):  # of rows that `write` refused
                    file.close()
            self._files = {}
            self._unlock()

    @contextmanager
    def _naming_the_folder(self) -> Iterator[None]:
        """Turn an error of the system into one that names the folder of this journal."""
        try:
            yield
        except OSError as problem:
            raise RecordingError(
                f"{self.folder} cannot be written to ({problem.strerror or problem}); make room. "
                f"What came before is kept."
            ) from None

    def _unlock(self) -> None:
        """Let other programs write to the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open_stream(self, readings: Readings, rows: Rows) -> BinaryIO:
        """Open the stream's file, and describe a new stream in recording.toml."""
        name = file_stem(readings.label, SensorError)
        described = name in self._kinds
        stream = Stream(name, rows, False, *self._stated[readings.label], keep_repeats=True)
        path = self.folder / f"{name}.csv"
        file = path.open("ab" if described or _has_rows(path) else "wb")
        self._files[name] = file
        if not file.tell():
            file.write((",".join(rows.columns) + "\n").encode())
            file.flush()
        if not described:
            stream = replace(stream, channel=readings.channel)
            text = self._described.read_text(encoding="utf-8")
            self._describe(text + describe_stream(stream))
            self._kinds[name] = readings.kind
        return file

    def _read_description(self) -> dict[str, str]:
        """Kinds of the streams in recording.toml by name; keeps their noise and mounts, too.

        Raises RecordingError if the recording is not a journal.
        """
        table = read_toml(self._described, RecordingError)
        if not table.flag("journal"):
            raise RecordingError(
                f"{self.folder} is a recording, but not a journal; give the journal a new folder."
            )
        kinds: dict[str, str] = {}
        for entry in table.tables("streams"):
            name, kind, mount = entry.text("name"), entry.text("kind"), entry.table("mount")
            kinds[name] = kind
            if kind in SENSORS and entry.peek("std") is not None:
                std = entry.std(SENSORS[kind].rows)
                self._stated[name] = std, mount.pose() if mount else np.eye(4)
        return kinds

    def _describe(self, text: str) -> None:
        """Write recording.toml, whole or not at all."""
        write_text(self._described, text)


def _std(readings: Readings) -> Array:
    """Standard deviations (rows,) of a reading, which must be the same for the whole stream."""
    cov = readings.cov
    if cov.ndim != 2 or np.any(cov != np.diag(np.diagonal(cov))) or readings.mount.ndim != 2:
        raise SensorError(
            f"{readings.label}: a journal keeps one standard deviation a row and one mount for a "
            f"whole stream; give `cov` as variances (rows,)."
        )
    return np.sqrt(np.diagonal(cov))[: readings.rows]


def _nearly_equal(stated: Array, given: Array) -> bool:
    """Whether numbers equal those of recording.toml up to the rounding of rotations."""
    return np.allclose(stated, given, rtol=1e-9, atol=1e-12)


def _lock_folder(folder: Path) -> int | None:
    """File descriptor of a lock on a folder, released at exit; None if there are no such locks.

    Raises RecordingError if another process holds the lock.
    """
    try:
        lock = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows
        return None
    try:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise RecordingError(
            f"Another program writes to {folder} now; wait for it, or give another folder."
        ) from None
    except OSError:  # a file system without locks
        pass
    return lock


def _has_rows(path: Path) -> bool:
    """Whether a stream's file has rows below its header."""
    return path.exists() and path.read_bytes().count(b"\n") > 1


def _remove_unfinished_line(path: Path) -> None:
    """Remove an unfinished last line. Raises RecordingError for a link or another kind of path."""
    if path.is_symlink() or not path.is_file():
        raise RecordingError(
            f"{path} is not a regular file; a journal writes to its own files alone."
        )
    with path.open("rb+") as file:
        text = file.read()
        file.truncate(text.rfind(b"\n") + 1)
