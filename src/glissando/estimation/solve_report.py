"""Report of the solver that comes with an estimate."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.outcome import Outcome


@dataclass(frozen=True)
class SolveReport:
    """Report of the solver: outcome, effort and fit.

    Attributes:
        outcome: Outcome of the solver.
        iterations: Number of iterations over all time nodes, from all starts.
        last_step: Length of the last step, posterior standard deviations.
        unknowns: Number of unknowns.
        cost: Half the sum of squared whitened residuals, or of their losses.
        log_fit: −cost − ½ log det of the noise and of the system, which the prior's normaliser
            completes to the log evidence (equation 22), `Posterior.log_evidence`.
        suspects: Number of readings to which a robust loss gave less than half their weight.
        seconds: Processor time by phase, s; empty for a posterior that was loaded.
        refused: Rows of each stream that were not used, as all other readings refute them.
        worst: If the estimate did not converge, the readings with the largest residuals.
        doubt: Sentence on why covariances are too small, if many readings contradict the estimate
            or other motions are probable.
        ambiguity: Sentence on other motions that the readings fit, if these are probable.
    """

    outcome: Outcome
    iterations: int
    last_step: float
    unknowns: int
    cost: float
    log_fit: float
    suspects: int
    seconds: dict[str, float] = field(compare=False)
    refused: dict[str, list[int]] = field(default_factory=dict)
    worst: str = ""
    doubt: str = ""
    ambiguity: str = ""

    @property
    def converged(self) -> bool:
        """Whether the solver met its criterion, so that the result can be trusted."""
        return self.outcome.sound

    @property
    def status(self) -> str:
        """The outcome as a sentence."""
        if self.converged:
            return self.outcome.sentence
        if self.outcome is Outcome.NO_DESCENT:  # the last step was damped to nothing
            return f"{self.outcome.sentence} after {self.iterations} iterations"
        if self.last_step < SolverOptions.tolerance:
            return f"{self.outcome.sentence}: {self.iterations} iterations, shortened to the last"
        return (
            f"{self.outcome.sentence}: {self.iterations} iterations, the last step still "
            f"{self.last_step:.2g} standard deviations long"
        )

    def to_table(self) -> dict[str, Any]:
        """The report as a table for JSON, without the times, which differ from run to run."""
        table = {**vars(self), "outcome": self.outcome.name}
        del table["seconds"]
        return table

    @staticmethod
    def from_table(table: dict[str, Any]) -> SolveReport:
        """The report that `to_table` wrote, or one of an earlier version, which had a status."""
        if "status" in table:
            status = table.pop("status")
            named = {"converged": "CONVERGED", "online": "UPDATED"}
            table |= {"outcome": named.get(status, "ITERATION_LIMIT"), "last_step": np.nan}
        if "log_evidence" in table:  # without the prior's normaliser
            table["log_fit"] = table.pop("log_evidence")
        return SolveReport(**{"seconds": {}, **table, "outcome": Outcome[table["outcome"]]})
