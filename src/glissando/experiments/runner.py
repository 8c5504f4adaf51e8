"""Running trials of scenes over seeds with Dask, on local processes or on a cluster."""

from __future__ import annotations

import signal
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from multiprocessing.resource_tracker import ensure_running
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from glissando import __version__
from glissando.errors import EstimateWarning, GlissandoError, needing
from glissando.evaluation.metrics import pool
from glissando.experiments.scenes import Scene, trial

if TYPE_CHECKING:
    import distributed

Row = dict[str, str | float | int | bool | None]
"""Result of a trial: values of METRICS by name, and `error`; missing values are None."""

METRICS = {
    "position_rmse": "over all truth sites and times, m",
    "rotation_rmse": "the same, rad",
    "nees_position": "squared error in units of its covariance, 1 a degree of freedom if true",
    "nees_rotation": "the same of rotation",
    "coverage95_position": "share of errors inside their 95 % ellipsoid",
    "converged": "1, or 0 for an estimate that stopped early",
    "iterations": "of the estimate",
}
"""Metrics of a row by name, with their meaning."""

_IN_FLIGHT = 4  # trials per thread, so that no worker has to wait for the next one
_PATIENCE = 30.0  # s to wait for a scheduler's answer and for a first worker


def outcome(scene: Scene, seed: int) -> Row:
    """Simulate and estimate a scene with a seed, and compare with truth; never raises an error.

    Args:
        scene: Scene to simulate and estimate.
        seed: Seed of the robot's imperfections and of all noise.

    Returns:
        The metrics; if the trial failed, None for each of them, and the message as `error`.
    """
    try:
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore", EstimateWarning)  # a column reports it
            result = trial(scene, seed)
    except GlissandoError as problem:
        return failure(str(problem))
    except Exception as problem:  # an error in one cell does not end a study
        return failure(f"{type(problem).__name__}: {problem}")
    summary, solve = pool(result.errors).summary(), result.posterior.solve
    row: Row = {name: summary[name] for name in METRICS if name in summary}
    row |= {"converged": float(solve.converged), "iterations": float(solve.iterations)}
    return {**row, "error": None}


def failure(sentence: str) -> Row:
    """Row of a failed trial, with the message as `error`."""
    return {**dict.fromkeys(METRICS), "error": sentence or "it failed without a word"}


def run_trials(
    client: distributed.Client, trials: Sequence[tuple[Scene, int]]
) -> Iterator[tuple[int, Row]]:
    """Run trials on a cluster and yield each as soon as it is done.

    When a worker dies, the trials queued on it are lost together with the one that killed it. Each
    of them is run once more at the end, one at a time.

    Args:
        client: Client of the cluster, from `cluster`.
        trials: Scenes with their seeds.

    Yields:
        Index of a trial and its row, in the order in which trials end.
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
    """Connect to a Dask cluster, or start one of local processes while the context lasts.

    Local processes communicate by TLS with a temporary key that is kept in memory, so that other
    users of the computer cannot run code on this cluster.

    Args:
        address: Address of a running scheduler; None to start local processes.
        workers: Number of local processes; None for one a core.

    Yields:
        Client of the cluster, which has at least one worker.

    Raises:
        GlissandoError: Dask is not installed, no scheduler answers at the address, no worker joins,
            or a worker has another version of glissando.
    """
    with needing("Trials run on Dask with cryptography", "study"):
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security

        ours = Security.temporary() if address is None else None
    with ExitStack() as stack:
        if address is None:
            # log level 50 silences all messages below critical; errors are in the rows
            # Dask's statistical profiler would take a tenth of a trial's time
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
    """Let processes started inside the context ignore Ctrl-C; this one obeys when it ends.

    A signal that arrives meanwhile, Ctrl-C or to terminate, is raised again at the end of the
    context, so that none is lost and none interrupts the start of processes midway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    blocks = hasattr(signal, "pthread_sigmask")  # Windows cannot, and loses a Ctrl-C
    names = ("SIGINT", "SIGTERM", "SIGHUP") if blocks else ()
    numbers = [getattr(signal, name) for name in names]
    waiting: list[int] = []
    mask: set[int] = set()
    handled = [n for n in numbers if signal.getsignal(n) != signal.SIG_IGN]
    before = {n: signal.signal(n, lambda got, _: waiting.append(got)) for n in handled}
    if blocks:
        ensure_running()  # its start unblocks Ctrl-C
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # inherited
    else:
        before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        try:
            if waiting:
                signal.raise_signal(waiting[0])
        finally:
            if blocks:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)


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
    """Version of glissando in the process that calls this."""
    return __version__
