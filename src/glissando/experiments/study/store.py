"""Results of a study on disk: a Parquet file for each batch as it comes, one table at the end.

A part is written beside its place and renamed into it, so that whatever kills the program leaves
whole parts only. The table depends on the study alone: not on the order of cells, on workers, or on
how often it was resumed.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glissando import __version__
from glissando.errors import GlissandoError
from glissando.experiments.study.cell import METRICS, Row
from glissando.experiments.study.plan import SETTINGS, Cell, Study, StudyError

if TYPE_CHECKING:
    import pyarrow

TABLE = "study.parquet"
"""The file of the joined table."""

_PARTS, _KEY = "parts", b"glissando"


def parquet() -> Any:
    """The module pyarrow.parquet. Raises GlissandoError when it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise GlissandoError(
            'Studies are kept in Parquet files: pip install "glissando[study]".'
        ) from None
    return pyarrow.parquet


def described(study: Study) -> dict[str, Any]:
    """What is stored with every file: version, and the settings that were asked for."""
    seeds = {"first": study.seeds.start, "count": len(study.seeds)}
    told = {"name": study.name, "grid": study.axes, "fixed": study.fixed, "seeds": seeds}
    return {"version": __version__, "study": told, "metrics": METRICS}


class Store:
    """The folder of a study: batches go in, the rows of all batches come out.

    Raises StudyError for results of another version, or of any when not to `resume`.
    """

    def __init__(self, study: Study, folder: Path, *, resume: bool) -> None:
        self.study, self.folder = study, folder
        self._parts = folder / _PARTS
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
        for row in table.to_pylist():
            self.rows[row.pop("id")] = row
        self._number = 1 + int(part.name.split("-")[0])

    def add(self, rows: dict[str, Row]) -> None:
        """Write a batch of rows by the ids of their cells; nothing for none."""
        if not rows:
            return
        table = _table([{"id": cell, **row} for cell, row in rows.items()], _result_fields())
        # two studies that fill a folder at once must not overwrite each other's
        name = f"{self._number:06d}-{uuid.uuid4().hex[:8]}.parquet"
        self._write(table, self._parts / name)
        self._number += 1
        self.rows |= rows

    def join(self, cells: Sequence[Cell]) -> pyarrow.Table:
        """Write the table of all cells in the order of the study, and return it."""
        rows = [{"id": c.id, **c.settings, "seed": c.seed, **self.rows[c.id]} for c in cells]
        table = _table(rows, _all_fields())
        self._write(table, self.folder / TABLE)
        return table

    def _write(self, table: pyarrow.Table, path: Path) -> None:
        told = {_KEY: json.dumps(described(self.study)).encode()}
        building = path.with_suffix(".writing")
        with building.open("wb") as file:
            parquet().write_table(table.replace_schema_metadata(told), file)
            file.flush()
            os.fsync(file.fileno())
        building.replace(path)


def _table(rows: list[dict[str, Any]], fields: Iterable[tuple[str, Any]]) -> pyarrow.Table:
    import pyarrow

    return pyarrow.Table.from_pylist(rows, schema=pyarrow.schema(list(fields)))


def _result_fields() -> list[tuple[str, Any]]:
    import pyarrow as pa

    return [("id", pa.string()), *((n, pa.float64()) for n in METRICS), ("error", pa.string())]


def _all_fields() -> list[tuple[str, Any]]:
    import pyarrow as pa

    kinds = {"robot": pa.string(), "prior": pa.string(), "shape": pa.string()}
    kinds |= {"slide": pa.string(), "still": pa.bool_(), "nodes": pa.int64(), "cycles": pa.int64()}
    settings = [(name, kinds.get(name, pa.float64())) for name in SETTINGS]
    first, *results = _result_fields()
    return [first, *settings, ("seed", pa.int64()), *results]
