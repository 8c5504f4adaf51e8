"""Results of a study on disk: a Parquet file for each batch, and one table at the end.

Each file is written whole or not at all, so that a killed program leaves only complete files. The
table depends on the study alone: not on the order of cells, the workers, or how often the study was
resumed.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glissando import __version__
from glissando.errors import needing
from glissando.experiments.runner import METRICS, Row, run_trials
from glissando.experiments.study.plan import SETTINGS, Cell, Study, StudyError
from glissando.io.atomic import new_file

if TYPE_CHECKING:
    import distributed
    import pyarrow

TABLE = "study.parquet"
"""Name of the file with the joined table."""

Progress = Callable[[int, int], None]
"""Called with the number of cells done, and the number that failed among them."""

_PARTS, _KEY = "parts", b"glissando"
_BATCH, _PAUSE = 100, 2.0  # cells, or seconds, after which a batch is written


def parquet() -> Any:
    """The module pyarrow.parquet. Raises GlissandoError if it is not installed."""
    with needing("Studies are kept in Parquet files by pyarrow", "study"):
        import pyarrow.parquet
    return pyarrow.parquet


class Store:
    """Folder of a study, to which batches of rows are added and joined to one table.

    Attributes:
        rows: Rows of all batches, by the ids of their cells.
    """

    def __init__(self, study: Study, folder: Path, *, resume: bool) -> None:
        """Open the folder. StudyError if it has results, unless `resume` and of this version."""
        self._study, self._folder, self._parts = study, folder, folder / _PARTS
        self._number = 0
        self.rows: dict[str, Row] = {}
        for part in sorted(self._parts.glob("*.parquet")):
            if not resume:
                raise StudyError(
                    f"{folder} holds results already; go on with --resume, or give another --out."
                )
            self._read(part)
        self._parts.mkdir(parents=True, exist_ok=True)

    def _read(self, part: Path) -> None:
        table = parquet().read_table(part)
        made_by = json.loads((table.schema.metadata or {}).get(_KEY, b"{}")).get("version")
        if made_by != __version__:
            raise StudyError(
                f"{part} is of glissando {made_by} and this is {__version__}; results of two "
                f"versions do not mix: give another --out."
            )
        self.rows |= {row.pop("id"): row for row in table.to_pylist()}
        self._number = 1 + int(part.name.split("-")[0])

    def add(self, rows: dict[str, Row]) -> None:
        """Write a batch of rows, by the ids of their cells; an empty batch is not written."""
        if not rows:
            return
        # two studies that fill a folder at once must not overwrite each other's
        name = f"{self._number:06d}-{uuid.uuid4().hex[:8]}.parquet"
        self._write([{"id": cell, **row} for cell, row in rows.items()], self._parts / name)
        self._number += 1
        self.rows |= rows

    def join(self, cells: Sequence[Cell]) -> pyarrow.Table:
        """Write the table of all cells in the order of the study, and return it."""
        rows = [{"id": c.id, **c.settings, "seed": c.seed, **self.rows[c.id]} for c in cells]
        return self._write(rows, self._folder / TABLE)

    def _write(self, rows: list[dict[str, Any]], path: Path) -> pyarrow.Table:
        import pyarrow

        study = self._study
        seeds = {"first": study.seeds.start, "count": len(study.seeds)}
        settings = {"name": study.name, "grid": study.axes, "fixed": study.fixed, "seeds": seeds}
        metadata = json.dumps({"version": __version__, "study": settings, "metrics": METRICS})
        table = pyarrow.Table.from_pylist(rows, schema=_schema(path.name == TABLE))
        with new_file(path) as building:
            parquet().write_table(
                table.replace_schema_metadata({_KEY: metadata.encode()}), building
            )
        return table


def _schema(with_settings: bool) -> pyarrow.Schema:
    import pyarrow as pa

    kinds = dict.fromkeys(("id", "robot", "prior", "shape", "slide", "error"), pa.string())
    kinds |= dict.fromkeys(("still", "paced", "dynamic"), pa.bool_())
    kinds |= dict.fromkeys(("nodes", "cycles", "seed"), pa.int64())
    settings = [*SETTINGS, "seed"] if with_settings else []
    names = ["id", *settings, *METRICS, "error"]
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in names])


def run_cells(
    client: distributed.Client,
    cells: Sequence[Cell],
    store: Store,
    progress: Progress | None = None,
) -> None:
    """Run cells on a cluster and add their rows to the store, also if interrupted."""
    failed, written = 0, time.monotonic()
    batch: dict[str, Row] = {}
    trials = [(cell.scene, cell.seed) for cell in cells]
    try:
        for done, (index, row) in enumerate(run_trials(client, trials), start=1):
            batch[cells[index].id] = row
            failed += row["error"] is not None
            if progress is not None:
                progress(done, failed)
            if len(batch) >= _BATCH or time.monotonic() > written + _PAUSE:
                store.add(batch)
                batch, written = {}, time.monotonic()
    finally:
        store.add(batch)
