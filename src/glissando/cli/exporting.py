"""`glissando export`: a posterior as a file that other programs read."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from glissando.cli.importing import number
from glissando.cli.shared import Commands, add_command, names, require_writable
from glissando.io.foreign import export
from glissando.io.netcdf import load_posterior

_HELP = """\
Write poses of a posterior, which estimate made, to a file that other programs read.

The name of --out chooses: .tum or .txt is a TUM trajectory for evo, t x y z qx qy qz qw at one
arclength; .csv has pose, strain, velocity and covariance of the pose; .mcap opens in Foxglove.
"""
_EXAMPLES = """\
examples:
  glissando export results/posterior.nc --out tip.tum
  glissando export results/posterior.nc --arclength 0.2,0.4 --rate 100 --out shape.csv
  glissando export results/posterior.nc --out motion.mcap

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add the command to the parser's."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "export", texts, _export)
    add = parser.add_argument
    add("posterior", type=Path, metavar="POSTERIOR", help="posterior.nc of an estimate")
    add("--out", type=Path, required=True, metavar="FILE", help=".tum, .txt, .csv or .mcap")
    add("--arclength", type=names, metavar="M,…", help="where (default: TUM tip, else all nodes)")
    add("--rate", type=float, metavar="HZ", help="poses a second (default: at the time nodes)")


def _export(options: argparse.Namespace) -> int:
    require_writable(options.out.parent)
    given = [number("--arclength", place) for place in options.arclength or ()]
    places = np.array(given) if given else None
    posterior = load_posterior(options.posterior)
    times = export(posterior, options.out, arclength=places, rate=options.rate)
    print(f"Wrote {options.out}: {times} times.")
    return 0
