"""Printing and writing of the loads on a robot, and of detected contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from glissando.cli.console import Console
from glissando.cli.progress import working
from glissando.estimation.contact import ContactScan, scan_contacts
from glissando.estimation.loads import load_places, require_mechanics
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.io.atomic import write_table
from glissando.model.evenly import evenly_chosen
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.visualization.canvas import save_figure
from glissando.visualization.contact_figure import contact_figure, mapped_times

CONTACT_COLUMNS = [
    *("time", "arclength", "log_evidence", "log_evidence_anywhere", "threshold"),
    *(f"{what}_{axis}" for what in ("f", "std_f") for axis in "xyz"),
]
"""Columns of contacts.csv: evidence at each arclength and time; for each time the force at the most
likely arclength, N in the body frame, and its std, NaN without evidence."""
_TIMES = 6  # number of times in the table of loads


def scanned(posterior: Posterior) -> ContactScan:
    """Scan for contacts at all time nodes, or at as many of them as a map shows."""
    with working("looking for contacts"):
        return scan_contacts(posterior, mapped_times(posterior))


def loads_json(posterior: Posterior, scan: ContactScan) -> dict[str, Any]:
    """Loads and contacts for JSON, SI units."""
    std = np.sqrt(np.einsum("kii->ki", scan.cov))
    contacts = {
        "false_alarms": scan.false_alarms,
        "time": scan.time.tolist(),
        "detected": scan.detected.tolist(),
        "evidence": scan.evidence.tolist(),
        "threshold": scan.threshold.tolist(),
        "arclength": scan.arclength[scan.best].tolist(),
        "force": _without_nan(scan.force),
        "std": _without_nan(std),
    }
    return {"loads": _load_rows(posterior), "contacts": contacts}


def print_loads(
    posterior: Posterior, scan: ContactScan, console: Console, *, tendons: bool = False
) -> None:
    """Print forces and moments with their standard deviations, and detected contacts.

    Args:
        posterior: Posterior with a mechanical prior.
        scan: Scan of the posterior for contacts.
        console: Console to print on.
        tendons: Whether the robot has tendons, whose loads the scan may detect as contacts.
    """
    table = Table("time (s)", "arclength (m)", title="What acts on the robot, world frame")
    for what in ("force x, y, z (N)", "moment x, y, z (N m)"):
        table.add_column(what, justify="right")
    for row in _load_rows(posterior):
        pairs = [
            f"{value:.3g} ± {std:.2g}"
            for value, std in zip(row["force"] + row["moment"], row["std"], strict=True)
        ]
        cells = ", ".join(pairs[:3]), ", ".join(pairs[3:])
        nearest = int(np.abs(scan.time - row["time"]).argmin())
        mark = " !" if scan.detected[nearest] else ""
        table.add_row(f"{row['time']:.3f}{mark}", f"{row['arclength']:.4f}", *cells)
    console.print(table)
    _print_contacts(posterior, scan, console)
    if tendons and scan.detected.any():
        console.print(
            "The prior knows no tendons, so that what they pull counts as a touch: give [prior] "
            "points where they end, with var_points as large as their moments.",
            markup=False,
        )


def _print_contacts(posterior: Posterior, scan: ContactScan, console: Console) -> None:
    """Print times, arclength and force of detected contacts, or that there are none."""
    detected, count = np.flatnonzero(scan.detected), scan.time.size
    observed = int(np.any(scan.log_ratio != 0.0, axis=-1).sum())  # others have no reading near
    of = f"{count} times"
    if observed < count:
        of = f"{observed} times beside which something was read"
    chance = f"of {of}; a false alarm is one in {1.0 / scan.false_alarms:.3g}"
    if not detected.size:
        console.print(f"Something else touches the robot at none {chance}.")
        return
    strongest = detected[np.argmax((scan.evidence - scan.threshold)[detected])]
    arclength, std_place = scan.arclength[scan.best[strongest]], scan.std_place[strongest]
    force, std = scan.force[strongest], np.sqrt(np.diagonal(scan.cov[strongest]))
    pairs = [f"{f:.2g} ± {s:.2g}" for f, s in zip(force, std, strict=True)]
    force_text = "" if np.isnan(force).any() else f", with ({', '.join(pairs)}) N in the body frame"
    console.print(
        f"Something else touches the robot at {detected.size} {chance}. Surest at "
        f"{scan.time[strongest]:.3f} s, likeliest there at {arclength:.3g} ± {std_place:.1g} m"
        f"{force_text}.",
        markup=False,
    )
    console.print(
        "At times marked ! the table explains by expected loads what the touch does: do not trust "
        "it there.",
        markup=False,
    )
    if (
        posterior.solve.doubt
        and count > 1
        and isinstance(prior := posterior.prior, MechanicalPrior)
    ):
        console.print(
            f"As readings contradict the estimate, neither place nor force is known so well. Loads "
            f"are believed to last {prior.time_scale:.3g} s ([prior] time_scale): a touch that "
            f"begins or ends faster makes moments before and after it seem touched, and is put at "
            f"a wrong place with a wrong force. Give one as short as touches are.",
            markup=False,
        )


def write_contacts(scan: ContactScan, folder: Path) -> list[Path]:
    """Write contacts.csv, a row for each time and place, and its map, contacts.png."""
    count = scan.arclength.size
    std = np.sqrt(np.einsum("kii->ki", scan.cov))
    columns = [
        np.repeat(scan.time, count),
        np.tile(scan.arclength, scan.time.size),
        scan.log_ratio.ravel(),
        np.repeat(scan.evidence, count),
        np.repeat(scan.threshold, count),
        *np.repeat(scan.force, count, axis=0).T,
        *np.repeat(std, count, axis=0).T,
    ]
    file = folder / "contacts.csv"
    write_table(file, CONTACT_COLUMNS, np.stack(columns, axis=1))
    return [file, save_figure(contact_figure(scan), folder / "contacts.png")]


def _without_nan(values: Array) -> list[list[float] | None]:
    """Rows of numbers for JSON; None for rows with NaN."""
    return [None if np.isnan(row).any() else row.tolist() for row in values]


def _load_rows(posterior: Posterior) -> list[dict[str, Any]]:
    """Loads at the arclengths where the prior has any, at a few times, in the world frame."""
    prior, nodes = require_mechanics(posterior.prior), posterior.grid.time
    places = load_places(prior, posterior.grid)
    rows = evenly_chosen(nodes.size, _TIMES)
    load = posterior.load(places, nodes[rows, None], frame="world")
    return [
        {
            "time": float(nodes[k]),
            "arclength": float(place),
            "force": load.force[i, j].tolist(),
            "moment": load.moment[i, j].tolist(),
            "std": load.std[i, j].tolist(),
        }
        for i, k in enumerate(rows)
        for j, place in enumerate(places)
    ]
