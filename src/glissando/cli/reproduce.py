"""`glissando reproduce`: computes the paper's claims, compares them and draws the figures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from glissando.cli.console import Console
from glissando.cli.outputs import require_results_folder
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command
from glissando.experiments.claims import CLAIMS, Verdict, load_claims
from glissando.experiments.run import reproduce

_HELP = """\
Reproduce "Sliding Sensors: Configurable Confidence in State Estimation for Continuum Robots" on
independent physics: every claim with the paper's number, ours, and whether it holds.

Writes results.json, the figures and an animation. The same seeds give the same table.
"""
_EXAMPLES = """\
examples:
  glissando reproduce --out results            # everything, minutes on two cores
  glissando reproduce --quick --out results    # nine of the claims, on fewer seeds, under a minute

exit status: 0 every claim holds; 1 one does not; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "reproduce", texts, _reproduce)
    add = parser.add_argument
    add("--quick", action="store_true", help="fewer seeds and scenes, under a minute")
    add("--claims", type=Path, default=CLAIMS, metavar="FILE", help="claims to judge (TOML)")
    add("--out", type=Path, default=Path("results"), metavar="DIR", help="default: results")


def _reproduce(options: argparse.Namespace) -> int:
    claims = load_claims(options.claims)
    require_results_folder(options.out)
    with working("starting") as work:

        def show(doing: str, done: int, whole: int) -> None:
            work.begin(doing)
            work.update(done, whole, f"{done} of {whole}" if whole > 1 else "")

        verdicts, written = reproduce(claims, options.out, quick=options.quick, progress=show)
    _print_verdicts(verdicts, Console())
    Console().print("Wrote " + ", ".join(str(path) for path in written), markup=False)
    return 1 if any(verdict.fails for verdict in verdicts) else 0


def _print_verdicts(verdicts: Sequence[Verdict], console: Console) -> None:
    """Print a table of claims, with those that go beyond the paper in a section below."""
    table = Table("claim", "paper", "ours", "verdict", title="Sliding Sensors, reproduced")
    before = False
    for verdict in verdicts:
        claim = verdict.claim
        if claim.beyond and not before:
            table.add_section()
        before = claim.beyond
        colour = {"holds": "green", "FAILS": "bold red"}.get(verdict.verdict)
        words = [f"[{colour}]{verdict.verdict}[/]"] if colour else []
        word = ", ".join([*words, *([verdict.size] if verdict.size else [])]) or "–"
        table.add_row(escape(claim.says), claim.paper, escape(verdict.ours), word)
    console.print(table)
