"""Run a study on Dask: local processes, or any cluster by the address of its scheduler."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from glissando import __version__
from glissando.errors import GlissandoError
from glissando.experiments.study.cell import Row, failure, outcome, version
from glissando.experiments.study.plan import Cell, StudyError
from glissando.experiments.study.store import Store

if TYPE_CHECKING:
    import distributed

Progress = Callable[[int, int], None]
"""Called with the number of cells done, and of those that failed among them."""

_WAITING = 4  # cells on their way a thread: enough that none waits for us
_BATCH, _PAUSE = 100, 2.0  # cells, and seconds, after which a part is written
_PATIENCE = 30.0  # s for a scheduler to answer and for a first worker


def run_cells(
    client: distributed.Client,
    cells: Sequence[Cell],
    store: Store,
    progress: Progress | None = None,
) -> None:
    """Run cells on a cluster; rows go to the store as they come, also when interrupted."""
    done, failed, written = 0, 0, time.monotonic()
    batch: dict[str, Row] = {}
    try:
        for cell, row in _outcomes(client, cells):
            batch[cell.id] = row
            done, failed = done + 1, failed + (row["error"] is not None)
            if progress is not None:
                progress(done, failed)
            if len(batch) >= _BATCH or time.monotonic() > written + _PAUSE:
                store.add(batch)
                batch, written = {}, time.monotonic()
    finally:
        store.add(batch)


def _outcomes(client: distributed.Client, cells: Sequence[Cell]) -> Iterator[tuple[Cell, Row]]:
    """Cells with their rows in the order in which they are done, a few on their way at a time.

    When a worker dies, cells that waited for it are lost with the one that killed it; each of them
    is asked once more, alone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    left, lost = iter(cells), []
    asked: dict[distributed.Future, Cell] = {}
    arriving = as_completed()

    def ask(count: int) -> None:
        for cell in islice(left, count):
            future = client.submit(outcome, cell.scene, cell.seed, pure=False)
            asked[future] = cell
            arriving.add(future)

    ask(_WAITING * max(1, sum(client.nthreads().values())))
    for future in arriving:
        cell = asked.pop(future)
        ask(1)
        try:
            yield cell, future.result()
        except KilledWorker:
            lost.append(cell)
    for cell in lost:
        try:
            yield cell, client.submit(outcome, cell.scene, cell.seed, pure=False).result()
        except KilledWorker:
            yield cell, failure("The cell kills its worker; is there too little memory?")


@contextmanager
def cluster(address: str | None, workers: int | None) -> Iterator[distributed.Client]:
    """A client of the scheduler at an address, else of as many local processes as `workers`.

    Raises StudyError when nobody answers, and when a worker has another version of glissando.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise GlissandoError('Studies run on Dask: pip install "glissando[study]".') from None
    with ExitStack() as stack:
        if address is None:
            # 50: of logging's levels the one that nothing reaches; errors are in the table
            local = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=50,
            )
            client = stack.enter_context(Client(stack.enter_context(local)))
        else:
            try:
                client = stack.enter_context(Client(address, timeout=_PATIENCE))
            except (OSError, ValueError) as problem:
                raise StudyError(
                    f"No scheduler answers at {address} ({problem}); start one with dask scheduler."
                ) from None
        _require_workers(client)
        yield client


def _require_workers(client: distributed.Client) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise StudyError(
            f"No worker has joined {client.scheduler.address} in {_PATIENCE:g} s; start some with "
            f"dask worker {client.scheduler.address}."
        ) from None
    for worker, theirs in client.run(version).items():
        if theirs != __version__:
            raise StudyError(
                f"Worker {worker} has glissando {theirs} and this is {__version__}; install one "
                f"version everywhere."
            )
