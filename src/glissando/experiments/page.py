"""The results as a page of Markdown: every number in it comes from the record of a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

_CLAIMS = """\
# Sliding Sensors, reproduced

What Walsh, Teetaert, Diller, Barfoot and Burgner-Kahrs (2026) claim, computed on independent
physics: a tendon-driven Cosserat rod with friction and set, and a tracker with bias, roll,
drop-outs and a registration error. Written by `glissando reproduce`; the same seeds give the same
page.

![A robot that moves from C to S, its sliding coil and its confidence](sliding.gif)

## Claims
"""
_CONFIDENCE = """\
## Confidence is highest where the sensor is

![Straight, C and S with the coil at the tip and 6 cm inside](confidence.png)

![A coil that slides the whole length](following.png)
"""
_TABLE = """\
## Fixed at the tip against sliding

RMSE over six motion capture frames and the whole session, 95 % intervals over seeds; every seed
draws another set of the tubes, bias, registration and noise, the same for all arms. Changes are
against the fixed sensor. The prior expects motion: what a coil saw of the tip grows stale while it
is at the base, unless the estimator knows that the robot holds *still*, or the slide is fast.

![Errors of fixed and sliding sensors](table.png)
"""
_MOVING = """\
## A robot that moves while the sensor slides

The robot goes from C to S in the time given. The paper expects that sliding fast against the
robot's motion helps most. A slow slide over the whole length can be worse than none: while the coil
is at the base, the tip moves unseen.

![Errors against the slide's speed](moving.png)
"""
_CAUSES = """\
## Where the size of the effect comes from

Oscillating against fixed, with one cause scaled at a time. Noise, bias and registration change a
fixed and a sliding sensor's errors alike, and the effect of sliding little. What decides is the set
of the tubes, which a sensor at the tip cannot see and a sliding one can. Without set the prior is
right about all but the joint of an S, and sliding can even hurt: what the coil sees beyond the
joint is taken to tell of the other side as well. Between no set and ours lies an effect as small as
the paper's, but there a fixed sensor would err less than the paper's does. What else keeps the
paper's robot from gaining more, this does not tell.

![Change by cause](causes.png)
"""


def page(record: dict[str, Any]) -> str:
    """The page of a record, as `glissando reproduce` keeps it in results.json."""
    results, seeds = record["results"], record["seeds"]
    versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
    size = "A quick run" if record["quick"] else "A full run"
    parts = [
        _CLAIMS,
        _claims(record["claims"]),
        f"{size}: seeds 0 up, {seeds['table']} for the claims, {seeds['beyond']} for the other arms"
        f" of the table, {seeds['moving']} for the moving robot, {seeds['causes']} for causes. "
        f"{versions}.",
        _CONFIDENCE,
        _distances(results),
        _TABLE,
        *(_arms(f"{shape}: ", arms) for shape, arms in results["table"].items()),
        _MOVING,
        *(_arms(f"C → S in {label}: ", arms) for label, arms in results["moving"].items()),
        _CAUSES,
        _changes(results["causes"]),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _claims(claims: Sequence[dict[str, Any]]) -> str:
    return _rows(
        ["claim", "paper", "ours", "verdict"],
        ([c["says"], c["paper"], c["ours"], c["verdict"] or "–"] for c in claims),
    )


def _distances(results: dict[str, Any]) -> str:
    found = {name: at for name, at in results["confidence"].items() if name != "worst"}
    rows = [
        [name, f"{1e3 * at['coil']:.0f}", f"{1e3 * at['minimum']:.0f}"]
        for name, at in found.items()
    ]
    return _rows(["coil", "coil at (mm)", "standard deviation least at (mm)"], rows)


def _spread(entry: dict[str, float], scale: float, digits: int) -> str:
    value, low, high = (f"{scale * entry[key]:.{digits}f}" for key in ("value", "low", "high"))
    return f"{value} ({low} … {high})"


def _change(entry: dict[str, float] | None) -> str:
    if entry is None:
        return ""
    return f"{entry['value']:+.1f} % ({entry['low']:+.1f} … {entry['high']:+.1f})"


def _arms(label: str, arms: dict[str, Any]) -> str:
    head = ["sensor", "position RMSE (mm)", "change", "orientation RMSE (rad)", "change"]
    head += ["NEES / dof", "inside 95 %", "seeds"]
    rows = [
        [
            label + name,
            _spread(arm["position"], 1e3, 2),
            _change(None if name.endswith("fixed") else arm["position_change"]),
            _spread(arm["rotation"], 1.0, 4),
            _change(None if name.endswith("fixed") else arm["rotation_change"]),
            f"{arm['nees']['value']:.2f}",
            f"{100 * arm['coverage']['value']:.0f} %",
            str(arm["seeds"]),
        ]
        for name, arm in arms.items()
    ]
    return _rows(head, rows)


def _changes(causes: dict[str, Any]) -> str:
    rows = [
        [label, *(_change(shapes[s][f"{what}_change"]) for s in ("C", "S") for what in _WHAT)]
        for label, shapes in causes.items()
    ]
    return _rows(["", "C position", "C orientation", "S position", "S orientation"], rows)


_WHAT = ("position", "rotation")
