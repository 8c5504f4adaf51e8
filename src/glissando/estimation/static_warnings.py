"""Warnings of static shapes: not found, contradicted by readings, or not the only probable."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

from glissando.errors import FalseConfidenceWarning, NotConvergedWarning
from glissando.estimation.other_shapes import OtherShapes
from glissando.estimation.solve_report import SolveReport

_NAMED = 10  # most shapes that a warning names
_REMEDY = (
    "Try a robust loss, more iterations (max_iterations), or leave out readings that disagree; "
    "where readings leave a shape open, sample_static draws those that explain them."
)


def warn_of_shapes(reports: Mapping[int, SolveReport], others: Sequence[OtherShapes]) -> None:
    """Warn of shapes, by number, at the line that called the caller.

    Each warning quotes the report of its first shape, or the shape that is most ambiguous.

    Args:
        reports: Reports of the shapes that were estimated alone.
        others: Shapes of which others are probable.
    """
    failed = [k for k, report in reports.items() if not report.converged]
    if failed:
        first = reports[failed[0]]
        words = [f"{_numbered(failed)} {first.status}.", first.worst, _REMEDY]
        warnings.warn(" ".join(filter(None, words)), NotConvergedWarning, stacklevel=3)
    doubtful = [k for k, report in reports.items() if report.converged and report.doubt]
    if doubtful:
        text = f"{_numbered(doubtful)} in doubt. {reports[doubtful[0]].doubt}"
        warnings.warn(text, FalseConfidenceWarning, stacklevel=3)
    if others:
        worst = max(others, key=lambda each: each.probability)
        text = (
            f"{_numbered([each.number for each in others])} not the only probable: the readings of "
            f"shape {worst.number} also fit others, with a probability of "
            f"{100.0 * worst.probability:.0f} %, up to {worst.distance:.2g} m away at "
            f"{worst.arclength:.3g} m. The covariance describes the neighbourhood of one; "
            f"sample_static draws from all."
        )
        warnings.warn(text, FalseConfidenceWarning, stacklevel=3)


def _numbered(shapes: Sequence[int]) -> str:
    """Beginning of a sentence on shapes, with their numbers."""
    if len(shapes) == 1:
        return f"Shape {shapes[0]} is"
    shown, more = ", ".join(map(str, shapes[:_NAMED])), len(shapes) - _NAMED
    return f"Shapes {shown}" + (f" and {more} more are" if more > 0 else " are")
