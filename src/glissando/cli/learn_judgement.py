"""Validation of `glissando learn` with truth that was not used for learning."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from glissando.calibration.robot.case import RecordingCase
from glissando.calibration.robot.hyperparameters import Document
from glissando.cli.say import say
from glissando.errors import GlissandoError
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import checked_window, run_estimate
from glissando.io.robot_file import parse_robot
from glissando.model.table import Table

_LEAST_INSIDE = 0.85  # least share of truth inside 95 %, for no warning


def judged(
    files: dict[str, Document], cases: list[RecordingCase], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Errors of estimates from the cases' sensors against held-out truth, with each robot file.

    Args:
        files: Robot documents by name.
        cases: Recordings that were learned from.
        options: Options of `glissando learn`.

    Returns:
        A summary of errors for each recording with such truth and each file.
    """
    summaries = []
    for case in cases:
        window = checked_window(case.recording, options.window)
        truth = options.hold_out or _marked_truth(case, window)
        use = with_rows(case.use, case, window)
        arguments: dict[str, Any] = {
            "window": window,
            "use": use,
            "truth": truth,
            "allow": options.allow,
        }
        for name, document in files.items() if truth else ():
            robot = parse_robot(Table(document, "learned", GlissandoError))
            summary = pool(run_estimate(case.recording, robot, **arguments).errors).summary()
            summaries.append({"file": name, "recording": case.recording.name, **summary})
    return summaries


def warn_of_confidence(report: dict[str, Any], options: argparse.Namespace) -> None:
    """Warn on stderr if the learned file is overconfident on held-out truth, or has no truth."""
    if "held_out" not in report:
        return
    for errors in report["held_out"]:
        inside = errors["coverage95_position"]
        if errors["file"] == "after" and inside < _LEAST_INSIDE:
            say(
                f"glissando: warning: with {options.out} {100.0 * inside:.1f} % of truth in "
                f"{errors['recording']} lie inside 95 %, so its confidence is false; learn from "
                f"truth (--truth), or from recordings of more shapes and motions."
            )
    if not report["held_out"] and not options.truth:
        say(
            f"glissando: no truth judges {options.out}. Readings alone cannot tell errors that "
            f"last, such as of a tracker's field, from shape; see that `glissando check` finds "
            f"its confidence true."
        )


def with_rows(
    streams: Sequence[str], case: RecordingCase, window: tuple[float, float]
) -> list[str]:
    """Names of streams that have rows in a window."""
    times = {name: case.recording.stream(name).rows.time for name in streams}
    return [name for name, t in times.items() if np.any((t >= window[0]) & (t <= window[1]))]


def _marked_truth(case: RecordingCase, window: tuple[float, float]) -> list[str]:
    """Names of streams marked as truth, if the case was learned without truth; else none."""
    return [] if case.predict else with_rows(case.recording.choose(None, None)[1], case, window)
