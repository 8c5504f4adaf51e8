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
from glissando.posterior import Posterior
from glissando.view import svg
from glissando.view.page import asset, page, subtitle
from glissando.view.scene import scene_of

_SCALES = {"position": (1e3, "mm"), "rotation": (180.0 / np.pi, "deg")}
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
        title=escape("Estimate of " + " and ".join([", ".join(labels[:-1]), labels[-1]]))
        if len(runs) > 1
        else escape(f"Estimate of {runs[0].told['recording']}"),
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
    found = {run.label: [run.site(name, quantity) for name in rows] for run in runs}
    rmse = {
        label: [scale * f["rmse"] if f else None for f in column] for label, column in found.items()
    }
    inside = {label: _covered(column[-1]) for label, column in found.items() if column[-1]}
    head = ["site"]
    for run in runs:
        of = f"{run.label}: " if len(runs) > 1 else ""
        head.append(f"{of}RMSE ({unit})")
        head += ["change"] if run is not runs[0] else []
        head += ["NEES / dof", "in 95 %", "confidence"]
    lines = []
    for i, name in enumerate(rows):
        cells = [name]
        for k, column in enumerate(found.values()):
            cells += _cells(column[i], scale, next(iter(found.values()))[i] if k else None)
        lines.append(cells)
    charts = svg.rows_of_dots(rows, rmse, unit) + svg.coverage(inside)
    return (
        f"<section><h2>{quantity.capitalize()} against truth</h2>"
        f'<div class="charts">{charts}</div>{_table(head, lines)}'
        '<p class="note">Squared error in units of its covariance (NEES) is 1 per degree of freedom'
        " when confidence is true; … are the bounds that 95 % of honest estimates keep. Bars in the"
        " chart of coverage are such bounds as well.</p></section>"
    )


def _cells(found: dict[str, Any], scale: float, first: dict[str, Any] | None) -> list[str]:
    """One run's cells at a site; `first` is what the first run has there, None for itself."""
    if not found:
        return [_DASH] * (4 if first is None else 5)
    cells = [f"{scale * found['rmse']:.2f}"]
    if first is not None:
        base = first.get("rmse")
        cells.append(f"{100 * (found['rmse'] / base - 1):+.1f} %" if base else _DASH)
    if "nees" not in found:
        return [*cells, *[_DASH] * 3]
    low, high = found["nees_bounds"]
    inside = 100 * found["coverage"]["0.95"]["share"]
    return [
        *cells,
        f"{found['nees']:.2f} ({low:.2f}…{high:.2f})",
        f"{inside:.1f} %",
        found["verdict"],
    ]


def _covered(found: dict[str, Any]) -> list[tuple[float, float, float, float]]:
    entries = found.get("coverage", {}).items()
    return [(float(level), entry["share"], *entry["bounds"]) for level, entry in entries]


def _innovations(runs: Sequence[Written]) -> str:
    """Whether each stream that was used is as far off as it should be."""
    head = ["stream", *(f"{run.label}: NIS / dof" for run in runs)]
    if len(runs) == 1:
        head[1] = "NIS / dof"
    found = [
        {c["site"]: c for c in run.told["consistency"] if c["quantity"] == "innovation"}
        for run in runs
    ]
    lines = []
    for name in dict.fromkeys(n for column in found for n in column):
        cells = [name]
        for column in found:
            c = column.get(name)
            bounds = "({:.2f}…{:.2f})".format(*c["nees_bounds"]) if c else ""
            cells.append(f"{c['nees']:.2f} {bounds}, {c['verdict']}" if c else _DASH)
        lines.append(cells)
    return f"<section><h2>Readings against each other</h2>{_table(head, lines)}</section>"


def _settings(runs: Sequence[Written]) -> str:
    """What each run was: a row a setting, a column a run."""
    rows: dict[str, list[str]] = {}
    for column, run in enumerate(runs):
        for name, text in _setting(run.told):
            rows.setdefault(name, [_DASH] * len(runs))[column] = text
    head = ["", *(run.label for run in runs)]
    lines = [[name, *cells] for name, cells in rows.items()]
    return f"<section><h2>Settings and versions</h2>{_table(head, lines)}</section>"


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
    posterior = Posterior.load(file)
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


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f'<div class="wide"><table><thead>{line(head, "th")}</thead>{body}</table></div>'
