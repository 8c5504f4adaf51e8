"""Progress of long work: a bar on a terminal, else a line on stderr every few seconds."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from glissando.cli.say import say

EVERY = 5.0
"""Seconds between lines if stderr is not a terminal."""
_SOON = 0.02  # share done from which the remaining time is shown


class Work:
    """State of a command's work: its description and the share done.

    Args:
        doing: Description of the first part of the work.
    """

    def __init__(self, doing: str) -> None:
        self.doing = ""
        self.begin(doing)

    def begin(self, doing: str) -> None:
        """Begin the next part of the work; no effect if it is the present one."""
        if doing != self.doing:
            self.doing, self.note, self._began = doing, "", time.monotonic()
            self.share: float | None = None
            self._came = 0.0  # s after which the present share was done

    def update(self, done: float, total: float, note: str = "") -> None:
        """Set the amount done, the total amount (0 if unknown), and a note."""
        share, self.note = min(done / total, 1.0) if total else None, note
        if share != self.share:
            self.share, self._came = share, time.monotonic() - self._began

    def line(self) -> str:
        """The state of the work as one line of text.

        >>> work = Work("estimating arm")
        >>> work.update(1, 4, "iteration 3")
        >>> work.line()
        'estimating arm: iteration 3, 25 % done, 0 s'
        """
        elapsed = time.monotonic() - self._began
        parts = [self.note] if self.note else []
        parts += [f"{100 * self.share:.0f} % done"] if self.share is not None else []
        parts.append(f"{elapsed:.0f} s")
        if self.share is not None and self.share > _SOON:
            remaining = self._came / self.share - elapsed  # counts down while a part lasts
            parts += [f"about {remaining:.0f} s left"] if remaining >= 0.5 else []
        return f"{self.doing}: {', '.join(parts)}"


class Descent:
    """Progress callback of a solver, which shows the iterations of an estimate.

    The share done is measured by the logarithm of the step's length, from the longest step to the
    tolerance. It is reset when the solver begins again from another start.

    Args:
        work: Work to update.
        tolerance: Length of a step, in standard deviations, at which the solver has converged.
    """

    def __init__(self, work: Work, tolerance: float) -> None:
        self._work, self._tolerance = work, tolerance
        self._longest, self._done, self._iteration = 0.0, 0.0, 0

    def __call__(self, iteration: int, cost: float, length: float) -> None:
        """Show an iteration with its cost and the length of its step, in standard deviations."""
        if iteration <= self._iteration:
            self._longest = self._done = 0.0
        self._iteration, self._longest = iteration, max(self._longest, length)
        remaining, total = (
            math.log(max(x / self._tolerance, 1.0)) for x in (length, self._longest)
        )
        self._done = max(self._done, 1.0 - remaining / total if total else 1.0)
        where = f"iteration {iteration}, cost {cost:.6g}, step {length:.3g} σ"
        if self._done < 1.0:
            self._work.update(self._done, 1, where)
        else:
            self._work.update(0, 0, f"{where}; judging readings, delays and other starts")


@contextmanager
def working(doing: str) -> Iterator[Work]:
    """Show work on stderr while the context lasts; a bar on a terminal is removed at the end.

    Args:
        doing: Description of the first part of the work.

    Yields:
        The work, whose state is shown.
    """
    work, over, console = Work(doing), threading.Event(), Console(stderr=True)
    show = _show_bar if console.is_terminal else _show_lines
    shown = threading.Thread(target=show, args=(work, over, console), daemon=True)
    shown.start()
    try:
        yield work
    finally:
        over.set()
        shown.join()


def _show_lines(work: Work, over: threading.Event, _: Console) -> None:
    while not over.wait(EVERY):
        say(f"glissando: {work.line()}")


def _show_bar(work: Work, over: threading.Event, console: Console) -> None:
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TaskProgressColumn()
    times = TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()
    with Progress(*columns, *times, console=console, transient=True) as bar:
        task, doing = bar.add_task(escape(work.doing), total=None), work.doing
        while not over.wait(0.1):
            if work.doing != doing:
                bar.reset(task, total=None)
                doing = work.doing
            text = escape(f"{doing}: {work.note}" if work.note else doing)
            total = None if work.share is None else 1.0
            bar.update(task, description=text, completed=work.share or 0.0, total=total)
