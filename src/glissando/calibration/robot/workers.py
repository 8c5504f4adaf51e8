"""Worker processes that evaluate the objective at perturbed robot files."""

from __future__ import annotations

import pickle
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from glissando.calibration.robot.average_information import Change, EvidenceAt
from glissando.calibration.robot.hyperparameters import Document
from glissando.calibration.robot.objective import Centre, Objective
from glissando.calibration.robot.predictive import Score
from glissando.errors import GlissandoError
from glissando.io.atomic import new_file

_objective: Objective | None = None  # set in worker processes


def _prepare(file: Path) -> None:
    global _objective
    _set_interrupt_handler(signal.SIG_IGN)  # ignore the terminal's Ctrl-C while idle
    _objective = pickle.loads(file.read_bytes())


def _set_interrupt_handler(handler: Any) -> None:
    if parent_process() is not None:  # not in the main process, as in tests
        signal.signal(signal.SIGINT, handler)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C interrupt the computation inside and propagate to the caller as an error."""
    _set_interrupt_handler(signal.default_int_handler)
    try:
        yield
    finally:
        _set_interrupt_handler(signal.SIG_IGN)


@contextmanager
def workers(objective: Objective, count: int) -> Iterator[ProcessPoolExecutor]:
    """Pool of processes that evaluate an objective.

    The objective is passed by a file: writing to the pipe of a process that ended would block.

    Args:
        objective: The objective.
        count: Number of processes.

    Raises:
        GlissandoError: A process ended unexpectedly.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "objective"
        with new_file(file) as building:
            building.write_bytes(pickle.dumps(objective, protocol=pickle.HIGHEST_PROTOCOL))
        with ProcessPoolExecutor(count, get_context("spawn"), _prepare, (file,)) as pool:
            try:
                yield pool
            except BrokenProcessPool:
                raise GlissandoError(
                    "The processes that learn ended; call learn from a script that begins with "
                    'if __name__ == "__main__":, and see that there is memory for them.'
                ) from None


def nearby_score(about: Centre, document: Document) -> Score | None:
    """Score a perturbed robot file in a worker, to first order; None if it cannot be estimated."""
    assert _objective is not None
    try:
        with _interruptible():
            score = _objective.score(document, about, beside=True).score
    except (GlissandoError, np.linalg.LinAlgError):
        return None
    return score if np.isfinite(score.value) else None


def nearby_changes(
    about: Centre, document: Document, beside: Sequence[tuple[Document, ...]]
) -> list[Change | None]:
    """Derivatives of the evidence by parameters, in a worker; None where there is no estimate.

    Args:
        about: Centre with the estimates of the file.
        document: Robot file at the centre.
        beside: For each parameter, the files with it perturbed, as taken by `EvidenceAt.change`.
    """
    assert _objective is not None
    changes: list[Change | None] = [None] * len(beside)
    with _interruptible(), suppress(GlissandoError, np.linalg.LinAlgError):
        evidence = EvidenceAt(_objective.cases, document, about.starts)
        for i, each in enumerate(beside):
            with suppress(GlissandoError, np.linalg.LinAlgError):
                change = evidence.change(*each)
                if np.isfinite([change.misfit, change.width]).all():
                    changes[i] = change
    return changes
