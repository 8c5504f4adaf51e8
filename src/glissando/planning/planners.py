"""Who makes a plan: the loop itself, at once, or another process while the loop goes on."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Protocol

from glissando.errors import GlissandoError
from glissando.planning.plan_slide import Plan
from glissando.twins import estimating

_READY, _END = 120.0, 5.0  # s that the process may take to begin and to end
_NICE = 10  # how far it stands back behind the loop

Task = Callable[[], Plan]
"""Makes a plan when called, here or, where it can be pickled, elsewhere."""


class GoneError(GlissandoError):
    """The planner's process has ended."""


class Planner(Protocol):
    """Makes one plan at a time: none is asked for before the last has been answered."""

    def ask(self, task: Task) -> None:
        """Have a plan made, without waiting for it."""
        ...

    def answer(self) -> Plan | None:
        """The plan if there is one by now, once; never waits.

        Raises GlissandoError when none can be made, GoneError when none ever will be.
        """
        ...


class InlinePlanner:
    """Plans in the loop's own thread, as soon as it is asked for the answer."""

    def __init__(self) -> None:
        self._task: Task | None = None

    def ask(self, task: Task) -> None:
        """Take the task."""
        self._task = task

    def answer(self) -> Plan | None:
        """The plan, made now."""
        task, self._task = self._task, None
        return None if task is None else task()


class ProcessPlanner:
    """Plans in a process of its own while the context lasts, on one thread and behind the loop.

    The process is started afresh ("spawn"), so a script that uses it needs the usual
    `if __name__ == "__main__":`, and zones and courses must be such that pickle takes them. Raises
    GlissandoError when it does not start.
    """

    def __enter__(self) -> ProcessPlanner:
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        try:
            if not self.ready(_READY):
                raise EOFError
            self._mine.recv()
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
        self._mine.close()

    def ready(self, timeout: float = 0.0) -> bool:
        """Whether an answer comes within so many seconds."""
        return self._mine.poll(timeout)

    def ask(self, task: Task) -> None:
        """Hand the task over. Raises GlissandoError when pickle does not take it."""
        try:
            parcel = pickle.dumps(task, protocol=pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError, TypeError) as problem:
            raise GlissandoError(
                f"What is to be planned cannot be sent to another process ({problem}); give zones "
                f"and courses as functions at the top of a module, not within others."
            ) from None
        threading.Thread(target=self._send, args=(parcel,), daemon=True).start()

    def _send(self, parcel: bytes) -> None:
        """Write what may be more than fits a pipe, for which the loop must not wait."""
        with suppress(OSError):
            self._mine.send_bytes(parcel)

    def answer(self) -> Plan | None:
        """The plan if it has come."""
        try:
            found = self._mine.recv() if self.ready() else None
        except (EOFError, OSError):
            raise GoneError("The planner's process has ended.") from None
        if isinstance(found, GlissandoError):
            raise found
        return found


def _work(tasks: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop says when to end
    if hasattr(os, "nice"):
        os.nice(_NICE)
    with estimating(), suppress(EOFError, OSError):
        tasks.send(None)  # ready
        while True:
            task: Task = tasks.recv()
            try:
                answer: Plan | GlissandoError = task()
            except GlissandoError as problem:
                answer = problem
            tasks.send(answer)
