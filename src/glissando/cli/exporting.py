"""`glissando export`: a posterior as a file that other programs read."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from glissando.cli.importing import number
from glissando.cli.outputs import require_replaceable, require_writable
from glissando.cli.shared import Commands, add_command, names, of_results
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.io.foreign import export
from glissando.io.foreign.trajectories import export_stream
from glissando.io.netcdf import load_posterior
from glissando.io.recording_folder import load_recording

_NUMBERS = tuple("-0123456789")
_BEGINS = {
    ".csv": ("time,arclength",), ".tum": _NUMBERS, ".txt": _NUMBERS, ".mcap": ("\ufffdMCAP",),
}  # fmt: skip

_HELP = """\
Write poses of a posterior, which estimate made, or a stream of a recording, such as the truth, to a
file that other programs read.

The name of --out chooses: .tum or .txt is a TUM trajectory for evo, t x y z qx qy qz qw at one
arclength; .csv has pose, strain, velocity and covariance of the pose; .mcap opens in Foxglove.
"""
_EXAMPLES = """\
examples:
  glissando export results/posterior.nc --out tip.tum
  glissando export results/posterior.nc --arclength 0.2,0.4 --rate 100 --out shape.csv
  glissando export results/posterior.nc --out motion.mcap
  glissando export my_recording --stream mocap_700 --out truth.tum     # then: evo_ape tum …

exit status: 0 done; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "export", texts, _export)
    add = parser.add_argument
    given = "posterior.nc of an estimate, or a recording"
    add("posterior", type=Path, metavar="POSTERIOR|RECORDING", help=given)
    add("--stream", metavar="NAME", help="of a recording, to write")
    add("--out", type=Path, required=True, metavar="FILE", help=".tum, .txt, .csv or .mcap")
    add("--arclength", type=names, metavar="M,…", help="where (default: TUM tip, else all nodes)")
    add("--rate", type=float, metavar="HZ", help="poses a second (default: at the time nodes)")


def _export(options: argparse.Namespace) -> int:
    require_writable(options.out.parent)
    begins = _BEGINS.get(options.out.suffix.lower(), ())
    require_replaceable("--out", options.out, options.posterior, begins=begins)
    given = [number("--arclength", place) for place in options.arclength or ()]
    places = np.array(given) if given else None
    source = of_results(options.posterior)
    if source.is_dir():
        return _export_stream(options)
    if options.stream:
        raise GlissandoError("--stream names one of a recording; give its folder.")
    times = export(load_posterior(source), options.out, arclength=places, rate=options.rate)
    print(f"Wrote {options.out}: {times} times.")
    return 0


def _export_stream(options: argparse.Namespace) -> int:
    recording = load_recording(options.posterior)
    recording.span()  # raises if there are no rows
    if options.stream not in recording.streams:
        raise GlissandoError(
            f"{options.posterior} is a recording: say with --stream which of "
            f"{', '.join(recording.streams)} is to be written."
        )
    refuse_unused(options, "--stream, which is written as it is", "arclength", "rate")
    stream = recording.streams[options.stream]
    if stream.frame != "world":
        raise GlissandoError(f"{stream.name} is in the frame {stream.frame!r}: calibrate it first.")
    print(f"Wrote {options.out}: {export_stream(stream, options.out)} times.")
    return 0
