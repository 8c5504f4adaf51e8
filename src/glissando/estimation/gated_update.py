"""An update of a sliding window: solve with what came, refuse what nothing else agrees with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from glissando.errors import UnobservableError, UnreachableError
from glissando.estimation.batch import estimate_in_passing
from glissando.estimation.given import require_base
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.outliers import CHANCE, under_touches
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.estimation.sliding_window import SlidingWindow
from glissando.estimation.window_parameters import NotLinearError
from glissando.model.sensors.readings import Readings
from glissando.solver.gauss_newton import SolverOptions

_RENEWED = 2  # intervals before the newest node that an update linearises again
_CLOSE = 0.02  # standard deviations: where the last step missed by less, the newest alone will do
_MISS = 0.05  # standard deviations by which a step may miss before it is followed by another
_LONG, _BRIEF = 30, 10  # iterations of a start, with other shapes and without
_SAVED = 400  # iterations that starts may take at once, and as many as updates after that
_SUDDEN = 0.1  # s: how fast touches come
_MOST = 5  # steps of a solution, and readings that any update may refuse


class GatedUpdate:
    """Updates of a window from a buffer of readings, each of which a gate judges."""

    def __init__(self, window: SlidingWindow, buffer: ReadingBuffer, gate: InnovationGate) -> None:
        self._window, self._buffer, self._gate = window, buffer, gate
        self._missed, self._spare = np.inf, _SAVED
        self._touched = under_touches(window.prior, window.arclength, _SUDDEN)

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

        Other shapes than rest cost as much as hundreds of updates and are tried as rarely, for
        readings that no shape explains, as of a tracker in another frame, come again and again.

        Args:
            fresh: New readings of each stream, cleared where no shape comes near.
        """
        window = self._window
        readings = self._buffer.streams(window.since(0))
        most = _LONG if self._spare > 0 else _BRIEF
        try:
            require_base(window.prior, readings)
            grid = window.grid()
            posterior = estimate_in_passing(
                window.prior,
                grid.at_times(grid.time, grid.before),  # a lone node for a second: nearer to rest
                readings,
                window.parameters.believed(),
                SolverOptions(max_iterations=most),
                gate=CHANCE,
            )
        except UnobservableError:
            return False  # not yet: some other sensor will fix the base
        except UnreachableError:
            self._spare -= most
            self._refuse_all(readings)
            fresh.clear()
            return False
        self._spare -= posterior.solve.iterations
        window.restate(posterior.state)
        return True

    def update(self, first: int, fresh: Counter[str], *, linear: bool) -> None:
        """Solve from a node on, more than once if far; refuse what nothing else agrees with.

        Where a wrong reading led, its neighbours look wrong: which one it is, is seen from where
        nodes were before. Of many readings no more than half are refused: where most disagree with
        what is believed, as when a robot moves as never before, the belief is what is wrong.
        None is refused that a touch explains, where the prior knows mechanics.

        Args:
            first: The node.
            fresh: New readings of each stream; refused ones are taken off.
            linear: Whether belief is narrow enough to refuse a reading by.

        Raises:
            NotLinearError: New readings contradict a belief that cannot refuse them.
        """
        self._spare = min(self._spare + 1, _SAVED)
        window, before = self._window, self._window.points
        most = max(_MOST, fresh.total() // 2)
        for again in range(most + 1):
            readings, wrong, broke = self.readings(first), None, None
            try:
                self._missed = _solve(window, first, readings, _MOST)
                wrong = self._most_wrong(window, fresh, first_look=not again) if fresh else None
                if wrong is None or again == most:
                    return
            except (np.linalg.LinAlgError, UnobservableError) as error:
                if not fresh or again == most:
                    raise
                broke = error
            if not linear:
                raise NotLinearError
            judge = window if broke else self._under_touches(first, readings)
            if judge is not window and (wrong := self._most_wrong(judge, fresh)) is None:
                return
            judge.points = before
            _solve(judge, first, readings, 1)
            wrong = self._most_wrong(judge, fresh) or wrong
            if wrong is None:
                raise broke or NotLinearError
            self._refuse(*wrong)
            fresh[wrong[0]] -= 1
            window.points = before

    def readings(self, first: int) -> HeldReadings:
        """Readings at and after a node."""
        return self._buffer.since(self._window.since(first))

    def refuse(self, fresh: Counter[str]) -> None:
        """Refuse all new readings of each stream, of which none is left."""
        held = self._buffer.streams(-np.inf)
        self._refuse_all([r.select(slice(len(r) - fresh[r.label], None)) for r in held])
        fresh.clear()

    def _under_touches(self, first: int, readings: HeldReadings) -> SlidingWindow:
        """The window solved as if something may touch the robot, or itself where that says nothing.

        It does not where the prior knows no loads, or the solution breaks down.
        """
        window = self._window
        if self._touched is window.prior:
            return window
        touched = window.with_prior(self._touched)
        try:
            _solve(touched, first, readings, _MOST)
        except (np.linalg.LinAlgError, UnobservableError):
            return window
        return touched

    def _most_wrong(
        self, window: SlidingWindow, fresh: Counter[str], *, first_look: bool = False
    ) -> tuple[str, float, float] | None:
        """Stream, time and arclength of the new reading that fits least, if beyond belief."""
        worst, wrong = 1.0, None
        for innovations in window.innovations(fresh):
            stream, places = innovations.stream, innovations.arclength.tolist()
            squares = innovations.nis.tolist(), innovations.dof
            if first_look:
                self._gate.note(stream, places, *squares)
            excess, at = self._gate.excess(stream, places, *squares)
            if excess > worst:
                worst, wrong = excess, (stream, innovations.time[at], places[at])
        return wrong

    def _refuse_all(self, streams: Sequence[Readings]) -> None:
        for readings in streams:
            for time, arclength in zip(readings.time, readings.arclength, strict=True):
                self._refuse(readings.label, time, arclength)

    def _refuse(self, stream: str, time: float, arclength: float) -> None:
        """Let go of a reading, one at a time as a wrong one makes its neighbours look wrong."""
        self._gate.strike(stream, arclength)
        self._buffer.discard(stream, time, arclength)


def _solve(window: SlidingWindow, first: int, readings: HeldReadings, most: int) -> float:
    """Linearise and solve from a node on until a step misses by little; by how much it does."""
    missed = np.inf
    for _ in range(most):
        window.relinearize(first)
        window.solve(first, readings)
        missed = window.miss(first)
        if missed < _MISS:
            break
    return missed
