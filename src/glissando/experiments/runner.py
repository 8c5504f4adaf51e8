"""Trials of scenes over seeds on Dask: on local processes, or on a cluster by its address."""

from __future__ import annotations

import signal
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from glissando import __version__
from glissando.errors import EstimateWarning, GlissandoError, needing
from glissando.evaluation.metrics import pool
from glissando.experiments.scenes import Scene, trial

if TYPE_CHECKING:
    import distributed

Row = dict[str, str | float | int | bool | None]
"""The result of a trial: every name of METRICS, and `error`; missing values are None."""

METRICS = {
    "position_rmse": "over all truth sites and times, m",
    "rotation_rmse": "the same, rad",
    "nees_position": "squared error in units of its covariance, 1 a degree of freedom if true",
    "nees_rotation": "the same of rotation",
    "coverage95_position": "share of errors inside their 95 % ellipsoid",
    "converged": "1, or 0 for an estimate that stopped early",
    "iterations": "of the estimate",
}
"""Numbers of a row, and what they are."""

_IN_FLIGHT = 4  # trials per thread: enough that no worker waits for the next one
_PATIENCE = 30.0  # s for a scheduler to answer and for a first worker


def outcome(scene: Scene, seed: int) -> Row:
    """Simulate, estimate and judge a scene with a seed; raises nothing but an interrupt.

    Args:
        scene: What is simulated and estimated.
        seed: Seed of the robot's imperfections and of all noise.

    Returns:
        The metrics, or None for each of them and the sentence of what went wrong.
    """
    try:
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore", EstimateWarning)  # a column reports it
            result = trial(scene, seed)
    except GlissandoError as problem:
        return failure(str(problem))
    except Exception as problem:  # a study outlives an error of any of its cells
        return failure(f"{type(problem).__name__}: {problem}")
    summary, solve = pool(result.errors).summary(), result.posterior.solve
    row: Row = {name: summary[name] for name in METRICS if name in summary}
    row |= {"converged": float(solve.converged), "iterations": float(solve.iterations)}
    return {**row, "error": None}


def failure(sentence: str) -> Row:
    """The row of a trial that failed, with the sentence that says why."""
    return {**dict.fromkeys(METRICS), "error": sentence or "it failed without a word"}


def run_trials(
    client: distributed.Client, trials: Sequence[tuple[Scene, int]]
) -> Iterator[tuple[int, Row]]:
    """Run trials on a cluster and yield each as soon as it is done.

    When a worker dies, the trials that waited for it are lost with the one that killed it; each of
    them is run once more, alone.

    Args:
        client: Client of the cluster, from `cluster`.
        trials: Scenes with their seeds.

    Yields:
        The index of a trial and its row, in the order in which trials end.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    waiting, lost = iter(range(len(trials))), list[int]()
    in_flight: dict[distributed.Future, int] = {}
    finished = as_completed()

    def submit(count: int) -> None:
        for index in islice(waiting, count):
            future = client.submit(outcome, *trials[index], pure=False)
            in_flight[future] = index
            finished.add(future)

    submit(_IN_FLIGHT * max(1, sum(client.nthreads().values())))
    for future in finished:
        index = in_flight.pop(future)
        submit(1)
        try:
            yield index, future.result()
        except KilledWorker:
            lost.append(index)
    for index in lost:
        try:
            yield index, client.submit(outcome, *trials[index], pure=False).result()
        except KilledWorker:
            yield index, failure("The cell kills its worker; is there too little memory?")


@contextmanager
def cluster(address: str | None = None, workers: int | None = None) -> Iterator[distributed.Client]:
    """Connect to a Dask cluster, or start one of local processes for as long as the context lasts.

    Local processes speak TLS with a key that is made for this cluster and kept in memory: nobody
    else on the computer can have it run anything.

    Args:
        address: Address of a running scheduler; None starts local processes.
        workers: Number of local processes, one a core unless given.

    Yields:
        A client of the cluster, which has at least one worker.

    Raises:
        GlissandoError: Dask is not installed, nobody answers at the address, no worker joins, or a
            worker has another version of glissando.
    """
    with needing("Trials run on Dask with cryptography", "study"):
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security

        ours = Security.temporary() if address is None else None
    with ExitStack() as stack:
        if address is None:
            # 50: of logging's levels the one that nothing reaches; errors are in the rows
            # Dask's statistical profiler would cost a tenth of a trial's time
            unwatched = dask.config.set({"distributed.worker.profile.enabled": False})
            with ignoring_interrupts(), unwatched:
                local = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    protocol="tls://",
                    security=ours,
                    dashboard_address="127.0.0.1:0",  # None would be port 8787 of all networks
                    scheduler_kwargs={"dashboard": False},
                    silence_logs=50,
                )
            client = stack.enter_context(Client(stack.enter_context(local)))
        else:
            try:
                client = stack.enter_context(Client(address, timeout=_PATIENCE))
            except (OSError, ValueError) as problem:
                raise GlissandoError(
                    f"No scheduler answers at {address} ({problem}); start one with dask scheduler."
                ) from None
        _require_workers(client)
        yield client


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """Let processes that begin inside ignore Ctrl-C: this one hears it, and ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _require_workers(client: distributed.Client) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise GlissandoError(
            f"No worker has joined {client.scheduler.address} in {_PATIENCE:g} s; start some with "
            f"dask worker {client.scheduler.address}."
        ) from None
    for worker, theirs in client.run(_version).items():
        if theirs != __version__:
            raise GlissandoError(
                f"Worker {worker} has glissando {theirs} and this is {__version__}; install one "
                f"version everywhere."
            )


def _version() -> str:
    """The version of glissando where this runs."""
    return __version__
