"""Runs side by side as one self-contained HTML page: numbers, charts, settings, figures, scenes."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.io.netcdf import load_posterior
from glissando.visualization.page import svg
from glissando.visualization.page.page import asset, page, subtitle
from glissando.visualization.page.scene import scene_of

_SCALES = {"position": (1e3, "mm"), "rotation": (180.0 / np.pi, "deg")}
_LEVELS = ("0.5", "0.9", "0.95", "0.99")
_DASH = "–"


@dataclass(frozen=True)
class Written:
    """What `glissando estimate --out` wrote: a label, its folder and its report.json."""

    label: str
    folder: Path
    told: dict[str, Any]

    def site(self, name: str, quantity: str) -> dict[str, Any]:
        """RMSE and consistency of a quantity at a site, or at 'all'; empty where it has none."""
        of_site = {s["name"]: s for s in self.told["sites"]} | {"all": self.told["overall"] or {}}
        checks = {(c["site"], c["quantity"]): c for c in self.told["consistency"]}
        rmse = of_site.get(name, {}).get(f"{quantity}_rmse")
        if name == "all" and ("all", quantity) not in checks and len(self.told["sites"]) == 1:
            name = self.told["sites"][0]["name"]
        return {} if rmse is None else {"rmse": rmse, **checks.get((name, quantity), {})}


def written_runs(folders: Sequence[Path]) -> list[Written]:
    """The runs in folders, labelled by the shortest ends of their paths that tell them apart.

    Raises GlissandoError for a folder without a report.json of `glissando estimate`.
    """
    paths = [folder.resolve() for folder in folders]
    if len(set(paths)) < len(paths):
        raise GlissandoError("A run is given twice; name each folder once.")
    deep = 1
    while len({path.parts[-deep:] for path in paths}) < len(paths):
        deep += 1
    return [Written("/".join(path.parts[-deep:]), path, _told(path)) for path in paths]


def _told(folder: Path) -> dict[str, Any]:
    file = folder / "report.json"
    try:
        told: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        told["sites"], told["consistency"], told["overall"]
    except OSError:
        raise GlissandoError(
            f"{folder} holds no report.json; make one with glissando estimate RECORDING --out DIR."
        ) from None
    except (ValueError, KeyError, TypeError):
        raise GlissandoError(
            f"{file} was not written by glissando estimate, or by an older one; estimate again."
        ) from None
    return told


def comparison(runs: Sequence[Written]) -> str:
    """The HTML of one run or several; changes are in per cent of the first.

    Scenes are those that `glissando estimate --view` wrote, else made of posterior.nc, without
    sensors and truth. Figures are the runs' own PNG files.
    """
    labels = [run.label for run in runs]
    parts = [svg.key(labels) if len(runs) > 1 else ""]
    parts += [_errors(runs, quantity) for quantity in _SCALES]
    if not any(run.told["sites"] for run in runs):
        parts.append("<p>No truth was given: there are no errors to tell.</p>")
    parts += [_innovations(runs), _settings(runs), _scenes(runs), _figures(runs)]
    return Template(asset("report.html")).substitute(
        title=escape(", ".join(labels)),
        style=asset("page.css") + asset("report.css"),
        body="\n".join(part for part in parts if part),
    )


def _errors(runs: Sequence[Written], quantity: str) -> str:
    """Charts and a table of the errors against truth, a row a site."""
    scale, unit = _SCALES[quantity]
    names = dict.fromkeys(s["name"] for run in runs for s in run.told["sites"])
    rows = [n for n in [*names, "all"] if any(run.site(n, quantity) for run in runs)]
    if not rows:
        return ""
    found = [[run.site(name, quantity) for name in rows] for run in runs]
    labels = [run.label for run in runs]
    dots = [[svg.Dot(scale * f["rmse"]) if f else None for f in column] for column in found]
    rmse = svg.chart(rows, dict(zip(labels, dots, strict=True)), f"RMSE ({unit})")
    inside = [[_share(column[-1], level) for level in _LEVELS] for column in found]
    coverage = svg.chart(
        [f"{100 * float(level):g} %" for level in _LEVELS],
        dict(zip(labels, inside, strict=True)),
        "errors inside the ellipsoid that should hold so many (%)",
        end=100.0,
        marks=[100 * float(level) for level in _LEVELS],
    )
    groups = [("", ["site"])]
    for k, label in enumerate(labels):
        change = ["change"] if k else []
        groups.append((label, [f"RMSE ({unit})", *change, "NEES / dof", "in 95 %", "confidence"]))
    lines = [
        [
            name,
            *(
                cell
                for k, column in enumerate(found)
                for cell in _cells(column[i], scale, k and found[0][i])
            ),
        ]
        for i, name in enumerate(rows)
    ]
    return (
        f"<section><h2>{quantity.capitalize()} against truth</h2>"
        f'<div class="charts">{rmse}{coverage}</div>{_table(groups, lines)}'
        '<p class="note">The squared error in units of its covariance (NEES) is 1 per degree of '
        "freedom when confidence is true; in brackets, and as bars, what 95 % of honest estimates "
        "keep to.</p></section>"
    )


def _cells(found: dict[str, Any], scale: float, first: dict[str, Any] | int) -> list[str]:
    """One run's cells at a site; `first` is what the first run has there, 0 for that run itself."""
    base = first.get("rmse") if isinstance(first, dict) else None
    change = [] if first == 0 else [_DASH]
    if not found:
        return [_DASH, *change, _DASH, _DASH, _DASH]
    if base:
        change = [f"{100 * (found['rmse'] / base - 1):+.1f} %".replace("-", "−")]
    told = [_DASH] * 3
    if "nees" in found:
        inside = 100 * found["coverage"]["0.95"]["share"]
        told = [_bounded(found), f"{inside:.1f} %", found["verdict"]]
    return [f"{scale * found['rmse']:.2f}", *change, *told]


def _bounded(found: dict[str, Any]) -> str:
    low, high = found["nees_bounds"]
    return f"{found['nees']:.2f} ({low:.2f}…{high:.2f})"


def _share(found: dict[str, Any], level: str) -> svg.Dot | None:
    if level not in found.get("coverage", {}):
        return None
    entry = found["coverage"][level]
    low, high = entry["bounds"]
    return svg.Dot(100 * entry["share"], (100 * low, 100 * high))


def _innovations(runs: Sequence[Written]) -> str:
    """Whether each stream that was used is as far off as it should be."""
    found = [
        {c["site"]: c for c in run.told["consistency"] if c["quantity"] == "innovation"}
        for run in runs
    ]
    groups = [("", ["stream"]), *((run.label, ["NIS / dof", "confidence"]) for run in runs)]
    lines = [
        [
            name,
            *(
                cell
                for c in (column.get(name) for column in found)
                for cell in ([_bounded(c), c["verdict"]] if c else [_DASH, _DASH])
            ),
        ]
        for name in dict.fromkeys(n for column in found for n in column)
    ]
    return f"<section><h2>Readings against each other</h2>{_table(groups, lines)}</section>"


def _settings(runs: Sequence[Written]) -> str:
    """What each run was: a row a setting, a column a run."""
    rows: dict[str, list[str]] = {}
    for column, run in enumerate(runs):
        for name, text in _setting(run.told):
            rows.setdefault(name, [_DASH] * len(runs))[column] = text
    groups = [("", [""]), *((run.label, [""]) for run in runs)]
    lines = [[name, *cells] for name, cells in rows.items()]
    return f"<section><h2>Settings and versions</h2>{_table(groups, lines)}</section>"


def _setting(told: dict[str, Any]) -> Iterable[tuple[str, str]]:
    for name in ("recording", "robot", "prior", "status", "iterations", "unknowns", "suspects"):
        if name in told:
            yield name, str(told[name])
    yield "window (s)", " to ".join(f"{t:g}" for t in told["window"])
    if "nodes" in told:
        yield "nodes", "{} times × {} arclengths".format(*told["nodes"])
    yield "log evidence", f"{told['log_evidence']:.1f}"
    yield "processor time (s)", f"{told['seconds']['total']:.2f}"
    for name, count in told["readings"].items():
        reasons = told["dropped"].get(name, {})
        lost = "".join(f", {n} {reason} dropped" for reason, n in reasons.items())
        yield f"readings of {name}", f"{count}{lost}"
    for unknown in told["calibration"]:
        pairs = zip(unknown["value"], unknown["std"], strict=True)
        yield unknown["name"], ", ".join(f"{v:.3g} ± {std:.2g}" for v, std in pairs)
    for name, number in told.get("versions", {}).items():
        yield name, number


def _scenes(runs: Sequence[Written]) -> str:
    frames = []
    for run in runs:
        ready = run.folder / "view.html"
        source = ready.read_text(encoding="utf-8") if ready.is_file() else _scene(run)
        if source:
            named = f'title="{escape(run.label)} over time"'
            frames.append(f'<iframe {named} srcdoc="{escape(source)}"></iframe>')
    return f'<section class="scenes"><h2>Over time</h2>{"".join(frames)}</section>'


def _scene(run: Written) -> str:
    """A page of the run's posterior.nc; empty where there is none."""
    file = run.folder / "posterior.nc"
    if not file.is_file():
        return ""
    posterior = load_posterior(file)
    scene = scene_of(posterior)
    return page(scene, run.label, subtitle(posterior, scene))


def _figures(runs: Sequence[Written]) -> str:
    pictures = []
    for name in ("shape", "confidence", "error"):
        for run in runs:
            file = run.folder / f"{name}.png"
            if file.is_file():
                data = base64.b64encode(file.read_bytes()).decode("ascii")
                said = escape(f"{run.label}: {name}")
                image = f'<img alt="{said}" src="data:image/png;base64,{data}">'
                pictures.append(f"<figure>{image}<figcaption>{said}</figcaption></figure>")
    return f'<section class="figures"><h2>Figures</h2>{"".join(pictures)}</section>'


def _table(groups: Sequence[tuple[str, list[str]]], rows: Sequence[Sequence[str]]) -> str:
    """A table under two lines of headings: the groups, each over its columns."""
    top = "".join(f'<th colspan="{len(c)}" scope="colgroup">{escape(g)}</th>' for g, c in groups)
    head = _line("th", [name for _, columns in groups for name in columns])
    body = "".join(_line("td", row) for row in rows)
    head = f"<thead><tr>{top}</tr>{head if any(any(c) for _, c in groups) else ''}</thead>"
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


def _line(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"
