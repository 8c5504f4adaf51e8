"""Batch estimation from start to posterior: solving, tests of readings, offsets and delays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import UnobservableError
from glissando.estimation.channels import settled
from glissando.estimation.delays import with_unseen_delays
from glissando.estimation.laplace_shift import at_mean
from glissando.estimation.misfit import breakdown, misfit_sentence, worst_readings
from glissando.estimation.outliers import (
    Mask,
    distinct_labels,
    judged,
    under_touches,
    used_at_first,
)
from glissando.estimation.place_evidence import by_evidence
from glissando.estimation.posterior import Posterior
from glissando.estimation.several_starts import Start, StartProblem, best_end, log_fit, start_at
from glissando.estimation.solve_report import SolveReport
from glissando.estimation.starting_point import starting_point, with_parameters
from glissando.estimation.transported import transported
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.gauss_newton import Progress, Solution, SolverOptions, Stopwatch, minimize
from glissando.solver.located_readings import locate

_ROUNDS = 5  # of solving and testing readings
Judged = tuple[Solution, Posterior, list[Mask]]
"""A solution, its posterior, and masks of the readings of each stream that it used."""


@dataclass(frozen=True)
class BatchProblem:
    """Batch estimation problem: prior, grid, readings and options.

    The posterior is about its mode, or about its mean if `mean` asks for it.
    """

    prior: Prior
    grid: Grid
    readings: Sequence[Readings]
    sensor_parameters: Sequence[SensorParameter]
    options: SolverOptions
    progress: Progress | None = None
    gate: float | None = None
    dates: bool = True
    keep_all: bool = False
    mean: bool = False
    clock: Stopwatch = field(default_factory=Stopwatch)

    def placed(self, start: Start) -> Posterior:
        """Posterior whose shape agrees with where it locates readings in channels."""
        load_kernels(self.prior)
        if not any(r.channel for r in self.readings):
            return self.corrected().posterior(start)

        def again(readings: list[Readings], initial: State | None) -> Posterior:
            return replace(self, readings=readings).corrected().posterior((initial, start[1]))

        shape = self.prior.rest_state(self.grid) if start[0] is None else start[0]
        return settled(again, self.readings, (self.prior, self.grid, shape), start[0])

    def corrected(self) -> BatchProblem:
        """The problem with readings corrected for known sensor parameters."""
        known = [parameter for parameter in self.sensor_parameters if parameter.known]
        return replace(self, readings=[corrected(r, known) for r in self.readings])

    def posterior(self, start: Start) -> Posterior:
        """Posterior from all readings but those that the others refute."""
        used = [used_at_first(r, self.gate) for r in self.readings]
        if not all(rows.all() for rows in used):
            locate(self.grid, self.readings, self.sensor_parameters)  # checks spikes, too
        with self.explained():
            (end, ambiguity), known = self.best_end(used, start), None
            if self.gate is not None:
                first, (end, known, used) = used, self.solve_without_refuted(end, used, self.gate)
                if not all(rows.all() for rows in used):
                    end, known, used = self.solve_with_touches(start, first, (end, known, used))
            seen = self.placed_by_evidence(end, used)
            seen = self.dated(seen) if self.dates else seen
            posterior = self.known_by(seen) if known is None or seen is not end else known
        if self.mean:
            with self.clock("covariance"):
                posterior = at_mean(posterior, seen.located)  # (37)
        report = posterior.solve
        doubt = report.doubt or ambiguity
        report = replace(report, refused=self.left_out(used), doubt=doubt, ambiguity=ambiguity)
        report = replace(report, seconds=self.clock.total())
        return replace(posterior, solve=report)

    @contextmanager
    def explained(self) -> Iterator[None]:
        """Raise an error that explains why solving breaks down, such as readings far off."""
        try:
            yield
        except (np.linalg.LinAlgError, UnobservableError) as error:
            raise breakdown(error, self.grid, self.prior, self.readings) from error

    def best_end(self, used: Sequence[Mask], start: Start) -> tuple[Solution, str]:
        """Best solution, and a sentence on other motions if they are probable, see `best_end`."""

        def piece(times: slice, initial: State | None) -> Solution:
            grid = Grid(self.grid.arclength, self.grid.time[times])
            inside = [r.inside(grid) for r in readings]
            part = replace(self, grid=grid, readings=inside, progress=None)
            every = [np.ones(len(r), dtype=bool) for r in inside]
            return part.best_end(every, (initial, ()))[0]

        readings = self.selected(used)
        sought = StartProblem(self.prior, self.grid, readings, self.options, piece)
        return best_end(sought, start, partial(self.minimum, used))

    def minimum(
        self, used: Sequence[Mask], initial: Start, options: SolverOptions | None = None
    ) -> Solution:
        """Solution of the iteration with the readings that are used."""
        readings = self.selected(used)
        progress, clock = self.progress, self.clock
        with one_thread():
            own = self.sensor_parameters
            located = locate(self.grid, readings, own, keep_all=self.keep_all)  # (16)
            located = with_parameters(located, initial[1])
            start, before = initial[0], 0
            if start is None:
                start, located, before = starting_point(self.prior, located, progress, clock)
            start = start.with_fields_of(self.prior.rest_state(self.grid))
            progress = _after(before, progress)
            options = options or self.options
            solution = minimize(self.prior, located, start, options, progress, clock)  # (19)
        return replace(solution, iterations=before + solution.iterations)

    def known_by(self, solution: Solution) -> Posterior:
        """Posterior of a solution, whose factor is overwritten."""
        fit = log_fit(solution)  # (22)
        with one_thread(), self.clock("covariance"):
            marginals = solution.cholesky.marginals(consume=True)  # (21)
            marginals = transported(solution.equations.state, solution.state, marginals)  # (35)
        return Posterior(
            self.prior,
            self.grid,
            solution.state,
            solution.equations.system,
            marginals,
            _report(self.prior, solution, fit, self.clock),
            solution.located.parameters.by_name(),
            (solution.equations.state, solution.equations.noise_state),
        )

    def placed_by_evidence(self, end: Solution, used: Sequence[Mask]) -> Solution:
        """Solution with arclength offsets at the mode of their evidence. Source: (22)."""

        def again(shifted: Sequence[SensorParameter], before: Solution) -> Solution:
            return replace(self, sensor_parameters=shifted).minimum(used, start_at(before))

        if not end.outcome.sound:
            return end
        with one_thread(), suppress(np.linalg.LinAlgError, UnobservableError):
            return by_evidence(self.prior, end, self.sensor_parameters, again)
        return end

    def dated(self, solution: Solution) -> Solution:
        """Solution with delays estimated from the motion of streams without a delay."""
        with one_thread():
            return with_unseen_delays(self.prior, solution, self.sensor_parameters, self.options)

    def solve_with_touches(self, start: Start, first: list[Mask], known: Judged) -> Judged:
        """Use also readings that a contact explains, if the prior is mechanical.

        Args:
            start: Start of the iteration.
            first: Masks of the readings that the first solution used.
            known: Solution without contacts.
        """
        prior = under_touches(self.prior, self.grid.arclength)
        if prior is self.prior or self.gate is None:
            return known
        rough = SolverOptions.rough(known[0].equations.rhs.size)
        touched = replace(self, prior=prior, options=rough)
        end, _ = touched.best_end(first, start)
        if not end.outcome.sound:
            return known
        end, _, fit = touched.solve_without_refuted(end, first, self.gate)
        used = [own | other for own, other in zip(known[2], fit, strict=True)]
        if all(map(np.array_equal, used, known[2])):
            return known
        better = self.minimum(used, start_at(end))
        return better, self.known_by(better), used

    def solve_without_refuted(self, end: Solution, used: list[Mask], gate: float) -> Judged:
        """Test readings and solve again, until those used are those that the others do not refute.

        Intermediate solutions are rough.
        """
        first, known = used, self.known_by(end)
        rough = self.options.rougher(end.equations.rhs.size)
        with suppress(np.linalg.LinAlgError):  # of an estimate that had not converged
            for _ in range(_ROUNDS):
                believed = judged(known, end, self.readings, used, gate)  # (25)
                if all(map(np.array_equal, used, believed)):
                    break
                better = self.minimum(believed, start_at(end), rough)
                known, end, used = self.known_by(better), better, believed
            if used is not first:
                better = self.minimum(used, start_at(end))
                known, end = self.known_by(better), better
        return end, known, used

    def selected(self, used: Sequence[Mask]) -> list[Readings]:
        """The readings that are used."""
        return [r.select(rows) for r, rows in zip(self.readings, used, strict=True)]

    def left_out(self, used: Sequence[Mask]) -> dict[str, list[int]]:
        """Rows of each stream that were not used, for streams with such rows."""
        pairs = zip(distinct_labels(self.readings), used, strict=True)
        return {name: np.flatnonzero(~rows).tolist() for name, rows in pairs if not rows.all()}


def _after(before: int, progress: Progress | None) -> Progress | None:
    """The progress callback, with iterations counted on from those before."""
    if progress is None or before == 0:
        return progress
    return lambda iteration, cost, length: progress(before + iteration, cost, length)


def _report(prior: Prior, solution: Solution, fit: float, clock: Stopwatch) -> SolveReport:
    """Report of the solver for the posterior."""
    at = solution.equations
    suspects = sum(int(np.sum(terms.robust_weights() < 0.5)) for terms in at.terms)
    return SolveReport(
        solution.outcome,
        solution.iterations,
        solution.last_step,
        at.rhs.size,
        solution.cost,
        fit,
        suspects,
        clock.total(),
        worst="" if solution.outcome.sound else worst_readings(solution),
        doubt=misfit_sentence(prior, solution) if solution.outcome.sound else "",
    )
