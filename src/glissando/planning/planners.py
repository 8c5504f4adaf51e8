"""Where a plan is computed: in the loop's own thread, or in another process beside the loop."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError

_READY, _END = 120.0, 5.0  # s that the process may take to begin and to end
_NICE = 10  # by how much its priority is below the loop's

Result = TypeVar("Result")
Task = Callable[[], Result]
"""Computes a plan when called; another process needs one that can be pickled."""


class PlannerExitedError(GlissandoError):
    """The planner's process has ended."""


class InlinePlanner(Generic[Result]):
    """Computes plans in the caller's own thread, when asked for the result.

    A planner computes one plan at a time: the result of a task comes before the next task.
    """

    def __init__(self) -> None:
        self._task: Task[Result] | None = None

    def submit(self, task: Task[Result]) -> None:
        """Keep the task."""
        self._task = task

    def result(self) -> Result | None:
        """The plan, computed now."""
        task, self._task = self._task, None
        return None if task is None else _planned(task)


class ProcessPlanner(Generic[Result]):
    """Computes plans in a process of its own, at a lower priority than the loop.

    The process lasts as long as the context. It is started afresh ("spawn"), so a script that uses
    it needs the usual `if __name__ == "__main__":`, and pickle must take the zones and motions.

    Raises:
        GlissandoError: The process does not start.
    """

    def __enter__(self) -> ProcessPlanner[Result]:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        try:
            if not self.ready(_READY):
                raise EOFError
            self._connection.recv()
        except (EOFError, OSError):
            self.__exit__()
            raise GlissandoError(
                "The planner's process did not start; run the loop from a script that begins with "
                'if __name__ == "__main__":, or leave the planner out.'
            ) from None
        return self

    def __exit__(self, *problem: object) -> None:
        self.process.terminate()
        self.process.join(_END)
        self._connection.close()

    def ready(self, timeout: float = 0.0) -> bool:
        """Whether a result comes within `timeout` seconds."""
        return self._connection.poll(timeout)

    def submit(self, task: Task[Result]) -> None:
        """Send the task to the process.

        Raises:
            GlissandoError: The task cannot be pickled.
        """
        try:
            message = pickle.dumps(task, protocol=pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError, TypeError) as problem:
            raise GlissandoError(
                f"What is to be planned cannot be sent to another process ({problem}); give zones "
                f"and motions as functions at the top of a module, not within others."
            ) from None
        threading.Thread(target=self._send, args=(message,), daemon=True).start()

    def _send(self, message: bytes) -> None:
        """Send what may be more than fits a pipe, for which the loop must not wait."""
        with suppress(OSError):
            self._connection.send_bytes(message)

    def result(self) -> Result | None:
        """The plan, once, if it is ready by now.

        Raises:
            GlissandoError: No plan can be made.
            PlannerExitedError: None ever will be.
        """
        try:
            answer = self._connection.recv() if self.ready() else None
        except (EOFError, OSError):
            raise PlannerExitedError("The planner's process has ended.") from None
        if isinstance(answer, GlissandoError):
            raise answer
        plan: Result | None = answer
        return plan


Planner = InlinePlanner[Result] | ProcessPlanner[Result]


def _planned(task: Task[Result]) -> Result:
    """The plan of a task; numbers that break down on the way are no plan, and no end either."""
    try:
        return task()
    except np.linalg.LinAlgError as problem:
        raise GlissandoError(f"A plan broke down ({problem})") from None


def _work(connection: Connection) -> None:
    """Answer one task after another until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop says when to end
    if hasattr(os, "nice"):
        os.nice(_NICE)
    with one_thread(), suppress(EOFError, OSError):
        connection.send(None)  # ready
        while True:
            task: Task[Any] = connection.recv()
            try:
                answer: object = _planned(task)
            except GlissandoError as problem:
                answer = problem
            connection.send(answer)
