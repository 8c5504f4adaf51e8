"""How an estimate was reached."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.outcome import Outcome


@dataclass(frozen=True)
class SolveReport:
    """How an estimate was reached.

    Attributes:
        outcome: How the solver ended.
        iterations: How many iterations over all time nodes it took, from all starts.
        last_step: Length of the last step, posterior standard deviations.
        unknowns: How many numbers were estimated.
        cost: Half the sum of squared whitened residuals, or of their losses.
        log_fit: −cost − ½ log det of the noise and of the system, of which the prior's factors make
            the log evidence (equation 22), `Posterior.log_evidence`.
        suspects: How many readings a robust loss gave less than half their weight.
        seconds: Processor time by phase; empty of a posterior that was loaded.
        refused: Rows of each stream that were not used, as all other readings refute them.
        worst: Of an estimate that did not converge, the readings that fit least where it ended.
        doubt: Why confidence is too small, if many readings contradict the estimate.
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

    @property
    def converged(self) -> bool:
        """Whether the result can be trusted: the solver reached what it was to reach."""
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
        """The report as JSON holds it, without the times, which differ from run to run."""
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
        if "log_evidence" in table:  # which lacked what the prior's factors leave out
            table["log_fit"] = table.pop("log_evidence")
        return SolveReport(**{"seconds": {}, **table, "outcome": Outcome[table["outcome"]]})
