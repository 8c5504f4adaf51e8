"""Output of `glissando learn`: results as JSON and as tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from glissando.calibration.robot.hyperparameters import Parameter
from glissando.calibration.robot.learn import Learned
from glissando.cli.console import TRUTH_HEADINGS, Console, number_table, parameter_text, truth_cells
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.io.robot_file import parse_robot
from glissando.model.table import Table


def as_json(result: Learned, out: Path) -> dict[str, Any]:
    """Result of learning as one JSON object."""
    return {
        "out": str(out),
        "objective_before": result.before.value,
        "objective_after": result.after.value,
        "degrees_of_freedom": result.before.samples,
        "steps": result.steps,
        "end": result.end.name.lower().replace("_", "-"),
        "parameters": [
            {"name": p.label, "value": p.of(result.document), **_change(p, moved, std)}
            for p, moved, std in zip(result.parameters, result.moved, result.std, strict=True)
        ],
        "constants": [
            {"name": c.name, "kind": c.kind, "value": c.value.tolist()}
            for c in result.after.constants
        ],
    }


def steps_of(result: Learned) -> str:
    """Number of steps of the search, in words."""
    return f"{result.steps} step{'s' if result.steps > 1 else ''}"


def _change(parameter: Parameter, moved: float, std: float) -> dict[str, float | None]:
    """Change of a hyperparameter and its std: a factor and log std, or a shift in its unit.

    The std is None if the recordings do not determine the hyperparameter.
    """
    finite_std = None if math.isinf(std) else std
    if parameter.unit is None:
        return {"factor": math.exp(moved), "log_std": finite_std}
    std_in_unit = None if finite_std is None else finite_std * parameter.unit
    return {"shift": moved * parameter.unit, "std": std_in_unit}


def _cells(change: dict[str, Any]) -> tuple[str, str]:
    """Change and std of a hyperparameter as cells of a table."""
    if "shift" in change:
        std = "–" if change["std"] is None else f"± {change['std']:.3g}"
        return f"{change['shift']:+.3g}", std
    std = "–" if change["log_std"] is None else f"× {math.exp(min(change['log_std'], 20.0)):.3g}"
    return f"× {change['factor']:.3g}", std


def print_report(result: Learned, report: dict[str, Any], std: dict[str, Array]) -> None:
    """Print the result of learning, with standard deviations (6,) of constants by name."""
    console = Console()
    table = number_table("What was learned", ("value", "moved", "known within"), left=("number",))
    for p in report["parameters"]:
        table.add_row(p["name"], f"{p['value']:.4g}", *_cells(p))
    console.print(table)
    learned = parse_robot(Table(result.document, "learned", GlissandoError)).sensor_parameters
    constants = [*result.after.constants, *(p for p in learned if p.name in std)]
    for c in constants:
        text = parameter_text(c.kind, c.value.tolist(), std.get(c.name, 0.0 * c.value).tolist())
        left = " (of this recording, not written)" if c.kind == "time_offset" else ""
        console.print(f"  {c.name} ({c.kind}): {text}{left}", markup=False)
    windows = "; ".join(f"{start:g} to {stop:g} s" for start, stop in report["windows"])
    console.print(f"Learned from {windows}")
    console.print(
        f"{steps_of(result)}; log-likelihood a degree of freedom {result.before.value:.4f} → "
        f"{result.after.value:.4f} ({result.before.samples:,} of them)"
    )
    if held_out := report.get("held_out"):
        table = number_table("Truth that was held out", TRUTH_HEADINGS, left=("file",))
        for held in held_out:
            table.add_row(held["file"], *truth_cells(held))
        console.print(table)
    console.print(f"Wrote {report['out']}", markup=False)
