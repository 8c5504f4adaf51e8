"""An update of a sliding window: solve with what came, refuse what nothing else agrees with."""

from __future__ import annotations

from collections import Counter

import numpy as np

from glissando.errors import UnobservableError, UnreachableError
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.given import require_base
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.outliers import CHANCE
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.estimation.sliding_window import LostError, SlidingWindow
from glissando.solver.gauss_newton import SolverOptions

_RENEWED = 2  # intervals before the newest node that an update linearises again
_CLOSE = 0.02  # standard deviations: where the last step missed by less, the newest alone will do
_MISS = 0.1  # standard deviations by which a step may miss before it is followed by another
_MOST = 5  # steps of a solution, and readings that any update may refuse


class GatedUpdate:
    """Updates of a window from a buffer of readings, each of which a gate judges."""

    def __init__(self, window: SlidingWindow, buffer: ReadingBuffer, gate: InnovationGate) -> None:
        self._window, self._buffer, self._gate = window, buffer, gate
        self._missed = np.inf

    def first_changed(self, earliest: float) -> int:
        """The first node whose interval is to be linearised again for readings since `earliest`."""
        time = self._window.nodes.time
        renewed = _RENEWED if self._missed > _CLOSE else 1
        if self._window.dating is not None:
            renewed = len(time)  # a delay is known by slopes, which later readings make better
        late = int(time.searchsorted(earliest, "right")) - 1
        return max(0, min(len(time) - 1 - renewed, late, self._window.intact - 1))

    def start(self, fresh: Counter[str]) -> bool:
        """Estimate all there is from rest, as a recording is; whether that could be done.

        Args:
            fresh: New readings of each stream, cleared where no shape comes near.
        """
        window = self._window
        readings = self._buffer.streams(window.since(0))
        try:
            require_base(window.prior, readings)
            posterior = estimate_in_passing(
                window.prior,
                window.grid(),
                readings,
                window.parameters.believed(),
                SolverOptions(max_iterations=30),
                gate=CHANCE,
            )
        except UnobservableError:
            return False  # not yet: some other sensor will fix the base
        except UnreachableError:
            for stream in readings:
                for time, arclength in zip(stream.time, stream.arclength, strict=True):
                    self._refuse(stream.label, time, arclength)
            fresh.clear()
            return False
        window.restate(posterior.state)
        return True

    def update(self, first: int, fresh: Counter[str], *, linear: bool) -> None:
        """Solve from a node on, more than once if far; refuse what nothing else agrees with.

        Where a wrong reading led, its neighbours look wrong: which one it is, is seen from where
        nodes were before. Of many readings no more than half are refused: where most disagree with
        what is believed, as when a robot is touched, the belief is what is wrong.

        Args:
            first: The node.
            fresh: New readings of each stream; refused ones are taken off.
            linear: Whether belief is narrow enough to refuse a reading by.

        Raises:
            LostError: New readings contradict a belief that cannot refuse them.
        """
        window, before = self._window, self._window.points
        most = max(_MOST, fresh.total() // 2)
        for again in range(most + 1):
            readings, wrong, broke = self.readings(first), None, None
            try:
                self._solve(first, readings, _MOST)
                wrong = self._most_wrong(fresh, first_look=not again) if fresh else None
                if wrong is None or again == most:
                    return
            except (np.linalg.LinAlgError, UnobservableError) as error:
                if not fresh or again == most:
                    raise
                broke = error
            if not linear:
                raise LostError
            window.points = before
            self._solve(first, readings, 1)
            wrong = self._most_wrong(fresh, first_look=False) or wrong
            if wrong is None:
                raise broke or LostError
            self._refuse(*wrong)
            fresh[wrong[0]] -= 1
            window.points = before

    def readings(self, first: int) -> HeldReadings:
        """Readings at and after a node."""
        return self._buffer.since(self._window.since(first))

    def _solve(self, first: int, readings: HeldReadings, most: int) -> None:
        """Linearise and solve from a node on until a step misses by little."""
        for _ in range(most):
            self._window.relinearize(first)
            self._window.solve(first, readings)
            self._missed = self._window.miss(first)
            if self._missed < _MISS:
                break

    def _most_wrong(
        self, fresh: Counter[str], *, first_look: bool
    ) -> tuple[str, float, float] | None:
        """Stream, time and arclength of the new reading that fits least, if beyond belief."""
        worst, wrong = 1.0, None
        for innovations in self._window.innovations(fresh):
            stream, nis, dof = innovations.stream, innovations.nis.tolist(), innovations.dof
            if first_look:
                self._gate.note(stream, nis, dof)
            excess = self._gate.excess(stream, nis, dof)
            if excess > worst:
                at = int(np.argmax(nis))
                worst, wrong = excess, (stream, innovations.time[at], innovations.arclength[at])
        return wrong

    def _refuse(self, stream: str, time: float, arclength: float) -> None:
        """Let go of a reading, one at a time as a wrong one makes its neighbours look wrong."""
        self._gate.strike(stream)
        self._buffer.discard(stream, time, arclength)
