"""Outcomes of iterative solvers: one enumeration for all of them, each member a sentence."""

from __future__ import annotations

from enum import Enum


class Outcome(Enum):
    """Outcome of a solver: `sentence` says what happened, `remedy` what to do about it."""

    CONVERGED = ("converged", "")
    UPDATED = ("updated online", "")
    ITERATION_LIMIT = (
        "not converged",
        "Try a finer time grid (time_rate), a robust loss, a start nearer the shape (initial or "
        "--start) or more iterations (max_iterations or --max-iterations).",
    )
    NO_DESCENT = (
        "not converged: no step lowers the cost",
        "Try a start nearer the shape (initial or --start), a robust loss, or leave out readings "
        "that disagree.",
    )

    def __init__(self, sentence: str, remedy: str) -> None:
        self.sentence, self.remedy = sentence, remedy

    @property
    def sound(self) -> bool:
        """Whether the result can be trusted."""
        return not self.remedy
