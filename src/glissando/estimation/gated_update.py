"""Update of a sliding window: solve with new readings, and refuse those that others refute."""

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
_CLOSE = 0.02  # standard deviations: if the last step's error was less, only the newest interval is
_MISS = 0.05  # standard deviations: a step with a larger error is followed by another
_ASTRAY = 10.0  # standard deviations: a solution whose last step has a larger error is none
_LONG, _BRIEF = 30, 10  # iterations of a start, with other shapes and without
_SAVED, _OWED = 400, 100  # most iterations saved up for starts, and owed; every update saves one
_SUDDEN = 0.1  # s: time scale of contacts
_MOST = 5  # most steps of a solution, and readings that any update may refuse


class GatedUpdate:
    """Updates a window from a buffer of readings, each tested by an innovation gate.

    Attributes:
        ambiguity: Sentence on other motions that the readings of the last start fit, if probable.
    """

    def __init__(self, window: SlidingWindow, buffer: ReadingBuffer, gate: InnovationGate) -> None:
        self._window, self._buffer, self._gate = window, buffer, gate
        self._missed, self._budget, self.ambiguity = np.inf, _SAVED, ""
        self._contact_prior = under_touches(window.prior, window.arclength, _SUDDEN)

    def first_changed(self, earliest: float) -> int:
        """First node whose interval must be linearised again for readings since `earliest`."""
        time = self._window.nodes.time
        renewed = _RENEWED if self._missed > _CLOSE else 1
        if self._window.dating is not None:
            renewed = len(time)  # delays depend on slopes, which later readings improve
        late = int(time.searchsorted(earliest, "right")) - 1
        return max(0, min(len(time) - 1 - renewed, late, self._window.intact - 1))

    def start(self, fresh: Counter[str]) -> bool:
        """Estimate the whole window from rest, as a recording; whether that succeeded.

        Starts other than rest cost as much as hundreds of updates and are tried as rarely, since
        readings that no shape explains, as of a tracker in another frame, come again and again.
        If too many iterations are owed, the next update begins at rest without a search.

        Args:
            fresh: Number of new readings of each stream; cleared if no shape explains them.
        """
        if self._budget < -_OWED:
            return True
        window = self._window
        readings = self._buffer.streams(window.since(0))
        most = _LONG if self._budget > 0 else _BRIEF
        try:
            require_base(window.prior, readings)
            grid = window.grid()
            posterior = estimate_in_passing(
                window.prior,
                grid.at_times(grid.time, grid.before),  # a single node lasts 1 s: nearer to rest
                readings,
                window.parameters.believed(),
                SolverOptions(max_iterations=most),
                gate=CHANCE,
            )
        except UnobservableError:
            return False  # until another sensor fixes the base
        except UnreachableError:
            self._budget -= most
            self._refuse_all(readings)
            fresh.clear()
            return False
        self._budget -= posterior.solve.iterations
        self.ambiguity = posterior.solve.ambiguity
        window.restate(posterior.state)
        return True

    def update(self, first: int, fresh: Counter[str], *, linear: bool) -> None:
        """Solve from a node on, in several steps if necessary, and refuse outliers.

        An outlier displaces the estimate so that its neighbours seem wrong; which reading is the
        outlier is decided by one step from the nodes before the update. At most half of many
        readings are refused: where most disagree with the estimate, as when a robot moves as never
        before, the estimate is wrong. With a mechanical prior no reading that a contact explains is
        refused.

        Args:
            first: First node to solve from.
            fresh: Number of new readings of each stream; refused ones are subtracted.
            linear: Whether the covariance is small enough for innovations to be tested.

        Raises:
            NotLinearError: New readings contradict an estimate too uncertain to refuse them, or the
                steps diverge.
        """
        self._budget = min(self._budget + 1, _SAVED)
        window, before = self._window, self._window.points
        most = max(_MOST, fresh.total() // 2)
        for attempt in range(most + 1):
            readings, wrong, breakdown = self.readings(first), None, None
            try:
                self._missed = _solve(window, first, readings, _MOST)
                wrong = self._worst(window, fresh, first_look=not attempt) if fresh else None
                if wrong is None or attempt == most:
                    break
            except (np.linalg.LinAlgError, UnobservableError) as error:
                if not fresh or attempt == most:
                    raise
                breakdown = error
            if not linear:
                raise NotLinearError
            judge = window if breakdown else self._with_contacts(first, readings)
            if judge is not window and (wrong := self._worst(judge, fresh)) is None:
                break
            judge.points = before
            _solve(judge, first, readings, 1)
            wrong = self._worst(judge, fresh) or wrong
            if wrong is None:
                raise breakdown or NotLinearError
            self._refuse(*wrong)
            fresh[wrong[0]] -= 1
            window.points = before
        if self._missed > _ASTRAY:
            raise NotLinearError

    def readings(self, first: int) -> HeldReadings:
        """Readings at and after a node."""
        return self._buffer.since(self._window.since(first))

    def refuse(self, fresh: Counter[str]) -> None:
        """Refuse all new readings of each stream and clear their numbers."""
        held = self._buffer.streams(-np.inf)
        self._refuse_all([r.select(slice(len(r) - fresh[r.label], None)) for r in held])
        fresh.clear()

    def _with_contacts(self, first: int, readings: HeldReadings) -> SlidingWindow:
        """The window solved with a prior of contacts.

        It is the window itself if the prior has no mechanics, or that solution breaks down.
        """
        window = self._window
        if self._contact_prior is window.prior:
            return window
        touched = window.with_prior(self._contact_prior)
        try:
            _solve(touched, first, readings, _MOST)
        except (np.linalg.LinAlgError, UnobservableError):
            return window
        return touched

    def _worst(
        self, window: SlidingWindow, fresh: Counter[str], *, first_look: bool = False
    ) -> tuple[str, float, float] | None:
        """Stream, time and arclength of the new reading farthest beyond the gate, if any."""
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
        """Refuse a single reading, as an outlier makes its neighbours seem wrong."""
        self._gate.strike(stream, arclength)
        self._buffer.discard(stream, time, arclength)


def _solve(window: SlidingWindow, first: int, readings: HeldReadings, most: int) -> float:
    """Linearise and solve from a node on until a step's error is small; that error."""
    missed = np.inf
    for _ in range(most):
        window.relinearize(first)
        window.solve(first, readings)
        missed = window.miss(first)
        if missed < _MISS:
            break
    return missed
