"""Learning the parameters of a robot file from recordings: densities, time scales, noise.

Parameters are scaled by exponentials, so they stay positive. The prior on a parameter's logarithm
has its mean at the initial value and the standard deviation ln 3: a parameter that the recordings
do not determine keeps its value. A step to a robot file that cannot be estimated is rejected.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from enum import Enum

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document, Parameter, moved
from glissando.calibration.robot.objective import Objective
from glissando.calibration.robot.predictive import Score, Start
from glissando.calibration.robot.search import Search
from glissando.calibration.robot.workers import workers
from glissando.errors import is_interrupt
from glissando.geometry.se3 import Array
from glissando.model.sensors.parameters import SensorParameter

Watch = Callable[[float, float, float], None]
"""Called with steps done, log posterior per degree of freedom, and steps expected in all."""


class End(Enum):
    """Reason for which a search ended."""

    SETTLED = "no step promises more"
    LAST_STEP = "it has taken the steps it may and would go on; run it again with more"
    NO_GAIN = "no part of a step that promised more gave it"
    INTERRUPTED = "it was interrupted; what it had found by then is kept"
    BROKEN = "a process that learns ended, perhaps for want of memory; what it had found is kept"


@dataclass(frozen=True)
class Learned:
    """A learned robot file.

    Attributes:
        document: The robot file.
        parameters: The parameters that were learned.
        moved: Logarithm of each parameter's factor (P,), or its shift in units.
        std: Marginal standard deviations (P,) of `moved`; ln 3, as in the prior, for a parameter
            that the data do not determine.
        before: Score of the initial robot file.
        after: Score of the learned robot file.
        steps: Number of steps.
        end: Reason for which the search ended.
        at_bounds: Labels of parameters that reached the bound of the search.
    """

    document: Document
    parameters: list[Parameter]
    moved: Array
    std: Array
    before: Score
    after: Score
    steps: int
    end: End
    at_bounds: tuple[str, ...]


def learn(
    document: Document,
    parameters: Sequence[Parameter],
    cases: Sequence[RecordingCase],
    *,
    calibrate: bool = False,
    constants: tuple[SensorParameter, ...] = (),
    start: Start | None = None,
    steps: int = 20,
    watch: Watch | None = None,
) -> Learned:
    """Learn the parameters of an expanded document from recordings.

    Args:
        document: Initial robot file, see `expanded`.
        parameters: The parameters to learn.
        cases: Windows of recordings.
        calibrate: Whether frame and mounts of the truth are calibrated, starting from `constants`.
        constants: Frame and mounts of the truth, and its delays in the first case.
        start: Initial guess of the first case's estimate.
        steps: Maximum number of steps.
        watch: Called during and after each step, see `Watch`.

    Raises:
        GlissandoError: The initial robot file cannot be estimated, or processes cannot start.
        KeyboardInterrupt: Ctrl-C was pressed before the first step was complete.
    """
    parameters = list(parameters)
    objective = Objective(cases, calibrate)
    most = min(os.cpu_count() or 1, 1 + len(parameters))
    with workers(objective, most) as pool:
        pool.map(int, range(most))  # starts the workers while the first estimate is made
        first = objective.score(document, objective.start(constants, start))
        search = Search(
            document, parameters, objective, pool, most, first, np.zeros(len(parameters))
        )
        progress = _Progress(search, max(steps, 1), watch)
        end = _run_search(progress, pool)
    learned, bound = moved(document, parameters, search.x), search.at_bounds
    names = tuple(p.label for p, at_bound in zip(parameters, bound, strict=True) if at_bound)
    scores = first.score, search.centre.score
    result = learned, parameters, search.x, search.std, *scores
    return Learned(*result, progress.count, end, names)


class _Progress:
    """Progress of a search, as reported to the caller.

    Attributes:
        search: The search.
        most: Maximum number of steps.
        count: Number of steps done.
    """

    def __init__(self, search: Search, most: int, watch: Watch | None) -> None:
        self.search, self.most, self.count = search, most, 0
        self._watch, self._share = watch, 0.0

    def tell(self, part: float = 0.0) -> None:
        """Report a fraction of the next step; the overall fraction done never decreases."""
        if self._watch is not None:
            done, expected = self.count + part, min(self.count + self.search.left, self.most)
            self._share = max(self._share, done / expected)  # the expected number may grow
            self._watch(done, -self.search.value, done / self._share)


def _run_search(progress: _Progress, pool: Executor) -> End:
    """Take steps until the search ends; return the reason.

    After the first step, interrupts and broken processes end the search and its result is kept.
    """
    search = progress.search
    try:
        while progress.count < progress.most:
            search.step(progress.tell)
            progress.count += 1
            progress.tell()
            if not search.left:
                return End.NO_GAIN if search.stuck else End.SETTLED
    except (KeyboardInterrupt, SystemError, BrokenProcessPool) as problem:
        broken = isinstance(problem, BrokenProcessPool)
        if not progress.count or not (broken or is_interrupt(problem)):
            raise
        pool.shutdown(wait=False, cancel_futures=True)
        return End.BROKEN if broken else End.INTERRUPTED
    return End.LAST_STEP
