"""Receivers of updates; none of them delays the estimate."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Protocol, Self, TextIO

import numpy as np

from glissando.errors import GlissandoError
from glissando.hardware.live.update import Update
from glissando.io.atomic import formats
from glissando.io.query_csv import QUERY_COLUMNS, state_rows


class Sink(Protocol):
    """A receiver of updates; a context manager.

    Attributes:
        name: Name of the sink in messages.
    """

    name: str

    @property
    def counts(self) -> Counter[str]:
        """Number of failures by name."""

    def __enter__(self) -> Self:
        """Open the sink."""

    def __exit__(self, *raised: object) -> None:
        """Close the sink."""

    def poll(self) -> None:
        """Process incoming messages of peers without waiting; called many times a second."""

    def send(self, update: Update) -> None:
        """Accept an update without waiting for a peer."""

    @property
    def problem(self) -> str:
        """Reason, as a phrase, why no peer receives updates; empty without a problem."""


class CsvSink:
    """Appends every update to a CSV file with the columns of `glissando estimate --query`.

    Args:
        path: New file.

    Raises:
        GlissandoError: The file exists, or cannot be written.
    """

    problem = ""

    def __init__(self, path: Path) -> None:
        self.name, self.counts, self._path = str(path), Counter[str](), path
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        try:
            self._file = self._path.open("x", encoding="utf-8")
        except OSError as problem:
            raise GlissandoError(
                f"{self._path} cannot be begun ({problem.strerror}); give a new file."
            ) from None
        self._file.write(",".join(QUERY_COLUMNS) + "\n")
        return self

    def __exit__(self, *raised: object) -> None:
        if self._file is not None:
            self._file.close()

    def poll(self) -> None:
        """Do nothing: a file has no incoming messages."""

    def send(self, update: Update) -> None:
        """Append the state at every point, and flush the file."""
        assert self._file is not None
        time = np.full(update.arclength.size, update.time)
        rows = state_rows(time, update.arclength, update.state)
        np.savetxt(self._file, rows, formats(QUERY_COLUMNS), ",")
        self._file.flush()
