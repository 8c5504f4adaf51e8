"""Planners compute plans: in the control loop's own thread, or in a separate process."""

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

_READY, _END = 120.0, 5.0  # s, timeouts for the start and the end of the process
_NICE = 10  # niceness of the process above that of the loop

Result = TypeVar("Result")
Task = Callable[[], Result]
"""Computes a plan when called; `ProcessPlanner` requires that it can be pickled."""


class PlannerExitedError(GlissandoError):
    """The planner's process has ended."""


class InlinePlanner(Generic[Result]):
    """Computes plans in the caller's own thread, when the result is requested.

    A planner computes one plan at a time: request the result of a task before the next task.
    """

    def __init__(self) -> None:
        self._task: Task[Result] | None = None

    def submit(self, task: Task[Result]) -> None:
        """Store the task until `result` is called."""
        self._task = task

    def result(self) -> Result | None:
        """Compute and return the plan of the stored task; None if there is none.

        Raises:
            GlissandoError: The task fails.
        """
        task, self._task = self._task, None
        return None if task is None else _planned(task)


class ProcessPlanner(Generic[Result]):
    """Computes plans in a separate process, at a lower priority than the loop.

    The process lives as long as the `with` block. It is started by the method "spawn", so a script
    needs the usual `if __name__ == "__main__":`, and zones and motions must be picklable.

    Raises:
        GlissandoError: The process does not start.
    """

    def __enter__(self) -> ProcessPlanner[Result]:
        context = multiprocessing.get_context("spawn")
        self._connection, child_end = context.Pipe()
        self.process = context.Process(target=_work, args=(child_end,), daemon=True)
        self.process.start()
        child_end.close()
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
        """Whether a result is available within `timeout` seconds."""
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
        """Send a message in a thread of its own, as one larger than the pipe's buffer blocks."""
        with suppress(OSError):
            self._connection.send_bytes(message)

    def result(self) -> Result | None:
        """Return the plan if it is ready, else None; each plan is returned once.

        Raises:
            GlissandoError: The task failed.
            PlannerExitedError: The process has ended, so no plan will follow.
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
    """Run a task; a numerical failure becomes a GlissandoError, so that the process goes on."""
    try:
        return task()
    except np.linalg.LinAlgError as problem:
        raise GlissandoError(f"A plan broke down ({problem})") from None


def _work(connection: Connection) -> None:
    """Receive tasks and send their plans until the connection closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends the process
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
