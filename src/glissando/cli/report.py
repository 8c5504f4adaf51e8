"""`glissando report`: comparison of runs of `estimate` on one HTML page."""

from __future__ import annotations

import argparse
from pathlib import Path

from glissando.cli.outputs import PAGE, require_replaceable, require_writable
from glissando.cli.shared import Commands, add_command
from glissando.io.atomic import write_text
from glissando.visualization.page.comparison import comparison, written_runs

_HELP = """\
Put runs side by side on one page: errors against truth with their confidence, coverage, readings
against each other, settings and versions, the robot over time, and the figures. Changes are in per
cent of the first run.

RUN is a folder that `glissando estimate --out` wrote; with `--view` it has sensors and truth in the
scene as well.
"""
_EXAMPLES = """\
examples:
  glissando estimate fixed --view --out results/fixed
  glissando estimate sliding --view --out results/sliding
  glissando report results/fixed results/sliding --out report.html

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "report", texts, _report)
    add = parser.add_argument
    add("runs", nargs="+", type=Path, metavar="RUN", help="folder that estimate --out wrote")
    add("--out", type=Path, metavar="FILE", default=Path("report.html"), help="page to write")


def _report(options: argparse.Namespace) -> int:
    require_writable(options.out.parent)
    require_replaceable("--out", options.out, *options.runs, begins=PAGE)
    write_text(options.out, comparison(written_runs(options.runs)))
    print(f"Wrote {options.out}; open it in a browser.")
    return 0
