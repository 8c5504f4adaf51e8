"""The results as a page of Markdown, whose numbers all come from the record of a run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import Any

_TEMPLATE = Path(__file__).with_name("page.md")
_FULL = re.compile("<!-- full run -->\n(.*?)<!-- end -->\n", re.DOTALL)  # absent from quick runs


def page(record: dict[str, Any]) -> str:
    """Markdown page of a record, as `glissando reproduce` writes it to results.json."""
    results, causes = record["results"], record["results"]["causes"]
    distances = [
        [name, f"{1e3 * at['coil']:.0f}", f"{1e3 * at['minimum']:.0f}"]
        for name, at in results["confidence"].items()
        if name != "worst"
    ]
    changes = [
        [label, *(cell for s in "CS" for cell in _effects(shapes[s]))]
        for label, shapes in causes.items()
    ]
    heads = [f"{s} {what}" for s in "CS" for what in ("fixed (cm, rad)", *_WHAT.values())]
    table, moving = results["table"].items(), results["moving"].items()
    claims = [[c["says"], c["paper"], c["ours"], _verdict(c)] for c in record["claims"]]
    text = _TEMPLATE.read_text(encoding="utf-8")
    return Template(_FULL.sub("" if record["quick"] else r"\1", text)).substitute(
        {f"seeds_{section}": count for section, count in record["seeds"].items()},
        claims=_rows(["claim", "paper", "ours", "verdict"], claims),
        size="A quick" if record["quick"] else "A full",
        versions=", ".join(f"{name} {number}" for name, number in record["versions"].items()),
        distances=_rows(["coil", "coil at (mm)", "standard deviation least at (mm)"], distances),
        table="\n\n".join(_arms(f"{shape}: ", arms) for shape, arms in table),
        moving="\n\n".join(_arms(f"C → S in {label}: ", arms) for label, arms in moving),
        causes=_rows(["", *heads], changes),
        passes=_arms("", results["passes"]) if results["passes"] else "",
    )


_WHAT = {"position": "position", "rotation": "orientation"}


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _spread(entry: dict[str, Any], scale: float, digits: int) -> str:
    value = f"{scale * entry['value']:.{digits}f}"
    if entry["low"] is None:
        return value
    low, high = (f"{scale * entry[key]:.{digits}f}" for key in ("low", "high"))
    return f"{value} ({low} … {high})"


def _change(entry: dict[str, Any]) -> str:
    value = f"{entry['value']:+.1f} %"
    if entry["low"] is None:
        return value
    return f"{value} ({entry['low']:+.1f} … {entry['high']:+.1f})"


def _verdict(claim: dict[str, Any]) -> str:
    """Verdict of a claim, and the size of its effect, as a cell."""
    return ", ".join(word for word in (claim["verdict"], claim["size"]) if word) or "–"


def _effects(arm: dict[str, Any]) -> list[str]:
    """Cells for the RMSE of a fixed sensor, and its changes by sliding."""
    fixed = f"{100 * arm['fixed_position']['value']:.2f}, {arm['fixed_rotation']['value']:.3f}"
    return [fixed, *(_change(arm[f"{what}_change"]) for what in _WHAT)]


def _arms(label: str, arms: dict[str, Any]) -> str:
    head = ["sensor", "position RMSE (mm)", "change", "orientation RMSE (rad)", "change"]
    head += ["NEES / dof", "inside 95 %", "seeds"]
    rows = []
    for name, arm in arms.items():
        changes = [_change(arm[f"{what}_change"]) for what in _WHAT]
        position, rotation = ["", ""] if name.endswith("fixed") else changes
        errors = _spread(arm["position"], 1e3, 2), position, _spread(arm["rotation"], 1.0, 4)
        inside = f"{100 * arm['coverage']['value']:.0f} %"
        numbers = f"{arm['nees']['value']:.2f}", inside, str(arm["seeds"])
        rows.append([label + name, *errors, rotation, *numbers])
    return _rows(head, rows)
