"""Comparison of runs as one self-contained HTML page: numbers, charts, settings and scenes."""

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
from glissando.io.plain_file import plain_text
from glissando.visualization.page import svg
from glissando.visualization.page.page import asset, page, subtitle
from glissando.visualization.page.scene import scene_of

_SCALES = {"position": (1e3, "mm"), "rotation": (180.0 / np.pi, "deg")}
_LEVELS = ("0.5", "0.9", "0.95", "0.99")
_DASH = "–"
_REPORT_ERRORS = (ValueError, KeyError, TypeError, AttributeError, IndexError, ArithmeticError)


@dataclass(frozen=True)
class WrittenRun:
    """Results that `glissando estimate --out` wrote.

    Attributes:
        label: Name of the run on the page.
        folder: Folder of the results.
        report: Content of report.json.
    """

    label: str
    folder: Path
    report: dict[str, Any]

    def site(self, name: str, quantity: str) -> dict[str, Any]:
        """RMSE and consistency of a quantity at a site, or at 'all'; empty if there is none."""
        sites, overall = self.report["sites"], self.report["overall"] or {}
        errors = {site["name"]: site for site in sites} | {"all": overall}
        checks = {(c["site"], c["quantity"]): c for c in self.report["consistency"]}
        rmse = errors.get(name, {}).get(f"{quantity}_rmse")
        if name == "all" and ("all", quantity) not in checks and len(sites) == 1:
            name = sites[0]["name"]
        return {} if rmse is None else {"rmse": rmse, **checks.get((name, quantity), {})}


def written_runs(folders: Sequence[Path]) -> list[WrittenRun]:
    """Runs in folders, labelled by the shortest distinct ends of their paths.

    Raises GlissandoError for a folder without a report.json of `glissando estimate`.
    """
    paths = [folder.resolve() for folder in folders]
    if len(set(paths)) < len(paths):
        raise GlissandoError("A run is given twice; name each folder once.")
    deep = 1
    while len({path.parts[-deep:] for path in paths}) < len(paths):
        deep += 1
    return [WrittenRun("/".join(path.parts[-deep:]), path, _report(path)) for path in paths]


def _report(folder: Path) -> dict[str, Any]:
    file = folder / "report.json"
    try:
        report: dict[str, Any] = json.loads(plain_text(file))
        report["sites"], report["consistency"], report["overall"]
    except OSError:
        raise GlissandoError(
            f"{folder} holds no report.json; make one with glissando estimate RECORDING --out DIR."
        ) from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise GlissandoError(
            f"{file} was not written by glissando estimate, or by an older one; estimate again."
        ) from None
    return report


def comparison(runs: Sequence[WrittenRun]) -> str:
    """HTML page of one run or several; changes are in per cent of the first.

    Scenes are those that `glissando estimate --view` wrote, or else made from posterior.nc, without
    sensors and truth. Figures are the runs' own PNG files.

    Raises:
        GlissandoError: The content of a report.json is not what `glissando estimate` writes.
    """
    try:
        return _page(runs)
    except _REPORT_ERRORS as problem:
        if isinstance(problem, GlissandoError):
            raise
        files = ", ".join(str(run.folder / "report.json") for run in runs)
        raise GlissandoError(
            f"{files}: an entry is not what glissando estimate writes ({problem}); estimate again."
        ) from None


def _page(runs: Sequence[WrittenRun]) -> str:
    """HTML page of runs with valid reports."""
    labels = [run.label for run in runs]
    parts = [svg.key(labels) if len(runs) > 1 else ""]
    parts += [_errors(runs, quantity) for quantity in _SCALES]
    if not any(run.report["sites"] for run in runs):
        parts.append("<p>No truth was given: there are no errors to tell.</p>")
    parts += [_innovations(runs), _settings(runs), _scenes(runs), _figures(runs)]
    return Template(asset("report.html")).substitute(
        title=escape(", ".join(labels)),
        style=asset("page.css") + asset("report.css"),
        body="\n".join(part for part in parts if part),
    )


def _errors(runs: Sequence[WrittenRun], quantity: str) -> str:
    """Charts and a table of the errors against truth, one row a site."""
    scale, unit = _SCALES[quantity]
    names = dict.fromkeys(s["name"] for run in runs for s in run.report["sites"])
    rows = [n for n in [*names, "all"] if any(run.site(n, quantity) for run in runs)]
    if not rows:
        return ""
    errors = [[run.site(name, quantity) for name in rows] for run in runs]
    labels = [run.label for run in runs]
    dots = [[svg.Dot(scale * f["rmse"]) if f else None for f in column] for column in errors]
    rmse = svg.chart(rows, dict(zip(labels, dots, strict=True)), f"RMSE ({unit})")
    inside = [[_share(column[-1], level) for level in _LEVELS] for column in errors]
    coverage = svg.chart(
        [f"{100 * float(level):g} %" for level in _LEVELS],
        dict(zip(labels, inside, strict=True)),
        "errors inside the ellipsoid that should hold so many (%)",
        end=100.0,
        marks=[100 * float(level) for level in _LEVELS],
    )
    heads = [f"RMSE ({unit})", "change", "NEES / dof", "in 95 %", "confidence"]
    groups = [("", ["site"]), (labels[0], [heads[0], *heads[2:]])]
    groups += [(label, heads) for label in labels[1:]]
    lines = []
    for name, first, *others in zip(rows, *errors, strict=True):
        cells = _cells(first, scale, {})
        cells = [cells[0], *cells[2:]]  # the first run has no change
        lines.append([name, *cells, *(c for o in others for c in _cells(o, scale, first))])
    return (
        f"<section><h2>{quantity.capitalize()} against truth</h2>"
        f'<div class="charts">{rmse}{coverage}</div>{_table(groups, lines)}'
        '<p class="note">The squared error in units of its covariance (NEES) is 1 per degree of '
        "freedom when confidence is true; in brackets, and as bars, what 95 % of honest estimates "
        "keep to.</p></section>"
    )


def _cells(site: dict[str, Any], scale: float, first: dict[str, Any]) -> list[str]:
    """Table cells of one run at a site, with the change relative to the `first` run."""
    cells = [_DASH] * 5
    if site:
        cells[0] = f"{scale * site['rmse']:.2f}"
    if site and first.get("rmse"):
        cells[1] = f"{100 * (site['rmse'] / first['rmse'] - 1):+.1f} %".replace("-", "−")
    if "nees" in site:
        inside = 100 * site["coverage"]["0.95"]["share"]
        cells[2:] = [_bounded(site), f"{inside:.1f} %", site["verdict"]]
    return cells


def _bounded(check: dict[str, Any]) -> str:
    low, high = check["nees_bounds"]
    return f"{check['nees']:.2f} ({low:.2f}…{high:.2f})"


def _share(site: dict[str, Any], level: str) -> svg.Dot | None:
    if level not in site.get("coverage", {}):
        return None
    entry = site["coverage"][level]
    low, high = entry["bounds"]
    return svg.Dot(100 * entry["share"], (100 * low, 100 * high))


def _innovations(runs: Sequence[WrittenRun]) -> str:
    """Table of the normalised innovations squared of each stream, with their bounds."""
    groups = [("", ["stream"]), *((run.label, ["NIS / dof", "confidence"]) for run in runs)]
    rows: dict[str, list[str]] = {}
    for column, run in enumerate(runs):
        for check in run.report["consistency"]:
            if check["quantity"] == "innovation":
                row = rows.setdefault(check["site"], [_DASH] * 2 * len(runs))
                row[2 * column : 2 * column + 2] = [_bounded(check), check["verdict"]]
    lines = [[name, *cells] for name, cells in rows.items()]
    return f"<section><h2>Readings against each other</h2>{_table(groups, lines)}</section>"


def _settings(runs: Sequence[WrittenRun]) -> str:
    """Table of the settings, one row a setting and one column a run."""
    rows: dict[str, list[str]] = {}
    for column, run in enumerate(runs):
        for name, text in _setting(run.report):
            rows.setdefault(name, [_DASH] * len(runs))[column] = text
    groups = [("", [""]), *((run.label, [""]) for run in runs)]
    lines = [[name, *cells] for name, cells in rows.items()]
    return f"<section><h2>Settings and versions</h2>{_table(groups, lines)}</section>"


def _setting(report: dict[str, Any]) -> Iterable[tuple[str, str]]:
    for name in ("recording", "robot", "prior", "status", "iterations", "unknowns", "suspects"):
        if name in report:
            yield name, str(report[name])
    yield "window (s)", " to ".join(f"{t:g}" for t in report["window"])
    if "nodes" in report:
        yield "nodes", "{} times × {} arclengths".format(*report["nodes"])
    if report.get("log_evidence") is not None:  # a batch estimate
        yield "log evidence", f"{report['log_evidence']:.1f}"
    for name, count in report["readings"].items():
        reasons = report["dropped"].get(name, {})
        lost = "".join(f", {n} {reason} dropped" for reason, n in reasons.items())
        yield f"readings of {name}", f"{count}{lost}"
    for unknown in report["calibration"]:
        pairs = zip(unknown["value"], unknown["std"], strict=True)
        yield unknown["name"], ", ".join(f"{v:.3g} ± {std:.2g}" for v, std in pairs)
    for name, number in report.get("versions", {}).items():
        yield name, number


def _scenes(runs: Sequence[WrittenRun]) -> str:
    frames = []
    for run in runs:
        ready = run.folder / "view.html"
        source = plain_text(ready, otherwise="utf-8") if ready.is_file() else _scene(run)
        if source:
            named = f'title="{escape(run.label)} over time"'
            # Sandboxed: a script of a page of unknown origin reaches nothing outside its frame.
            frames.append(
                f'<iframe {named} sandbox="allow-scripts" srcdoc="{escape(source)}"></iframe>'
            )
    return f'<section class="scenes"><h2>Over time</h2>{"".join(frames)}</section>'


def _scene(run: WrittenRun) -> str:
    """Page of the run's posterior.nc; empty if there is none."""
    file = run.folder / "posterior.nc"
    if not file.is_file():
        return ""
    posterior = load_posterior(file)
    scene = scene_of(posterior)
    return page(scene, run.label, subtitle(posterior, scene))


def _figures(runs: Sequence[WrittenRun]) -> str:
    pictures = []
    for name in ("shape", "confidence", "error"):
        for run in runs:
            file = run.folder / f"{name}.png"
            if file.is_file():
                data = base64.b64encode(file.read_bytes()).decode("ascii")
                caption = escape(f"{run.label}: {name}")
                image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
                pictures.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    return f'<section class="figures"><h2>Figures</h2>{"".join(pictures)}</section>'


def _table(groups: Sequence[tuple[str, list[str]]], rows: Sequence[Sequence[str]]) -> str:
    """HTML table with two header rows: the groups, and their columns."""
    top = "".join(f'<th colspan="{len(c)}" scope="colgroup">{escape(g)}</th>' for g, c in groups)
    head = _line("th", [name for _, columns in groups for name in columns])
    body = "".join(_line("td", row) for row in rows)
    head = f"<thead><tr>{top}</tr>{head if any(any(c) for _, c in groups) else ''}</thead>"
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


def _line(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"
