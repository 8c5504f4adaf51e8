"""`glissando figure`: one figure of a posterior, for a report or a paper."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from glissando.cli.importing import number
from glissando.cli.outputs import require_writable
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import (
    Commands,
    add_choices,
    add_command,
    names,
    of_results,
    posterior_shown,
)
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.estimation.contact import scan_contacts
from glissando.visualization.canvas import INCH, SIDES, require_ending, save_figure
from glissando.visualization.contact_figure import contact_figure, mapped_times
from glissando.visualization.figures import confidence_figure, error_figure
from glissando.visualization.shape_figure import shape_figure

_HELP = """\
Draw one figure of a posterior: the robot's shape in space with 95 % ellipsoids, its confidence over
arclength and time, its errors against truth in 95 % bands, or the evidence of contacts over
arclength and time, of a robot whose mechanics are known. The ending of --out chooses PNG, PDF or
SVG.

RECORDING is estimated first; POSTERIOR is a posterior.nc of an earlier estimate, or the folder it
is in, and takes sensors and truth from --recording.
"""
_EXAMPLES = """\
examples:
  glissando figure shape results --recording my_recording --out shape.pdf
  glissando figure confidence results --recording my_recording --size 88,60 --out confidence.pdf
  glissando figure error results --recording my_recording --font-size 7 --out error.svg
  glissando figure shape results --times 0.5,1.5 --out two.png

exit status: 0 done; 1 the estimate did not converge; 2 something given was wrong.
"""
_LARGEST = 100.0  # largest font size, points
_KINDS = ("shape", "confidence", "error", "contacts")


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "figure", (_HELP, _EXAMPLES), _figure)
    add = parser.add_argument
    add("kind", choices=_KINDS, metavar="|".join(_KINDS), help="what to draw")
    add("target", type=Path, metavar="RECORDING|POSTERIOR", help="folder, or a posterior.nc")
    add("--recording", type=Path, metavar="FOLDER", help="sensors and truth of a posterior")
    add_choices(parser)
    add("--times", type=names, metavar="S,…", help="of the shapes (default: five)")
    add("--size", metavar="MM,MM", help="width and height of the figure")
    add("--font-size", type=float, metavar="PT", help="of all text (default 11)")
    add("--out", type=Path, required=True, metavar="FILE", help="ends in .png, .pdf or .svg")


def _figure(options: argparse.Namespace) -> int:
    require_ending(options.out)
    require_writable(options.out.parent)
    appearance = _appearance(options)
    times = None if options.times is None else [number("--times", t) for t in options.times]
    if times == []:
        raise GlissandoError("--times names no time; give seconds, separated by commas.")
    if options.kind != "shape":
        refuse_unused(options, f"the figure {options.kind}", "times")
    if of_results(options.target).is_file():
        refuse_unused(options, "a posterior, which is drawn whole", "window")
        if options.recording is None:
            refuse_unused(options, "a figure of a posterior without --recording", "robot")
            if options.kind == "error":
                raise GlissandoError(
                    "A posterior holds no truth: give the folder that does with --recording FOLDER."
                )
    shown = posterior_shown(options)
    with working("drawing"):
        if options.kind == "shape":
            drawn: Any = shape_figure(shown.posterior, shown.truth, times, **appearance)
        elif options.kind == "confidence":
            drawn = confidence_figure(shown.posterior, shown.readings, **appearance)
        elif options.kind == "contacts":
            scan = scan_contacts(shown.posterior, mapped_times(shown.posterior))
            drawn = contact_figure(scan, **appearance)
        else:
            drawn = error_figure(shown.posterior, shown.truth, **appearance)
        save_figure(drawn, options.out)
    print(f"Wrote {options.out}")
    if shown.complaint:
        say(f"glissando: {shown.complaint}")
    return 0 if shown.posterior.solve.converged else 1


def _appearance(options: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments `size` (inches) and `style` of the functions that draw figures."""
    texts = (options.size or "").split(",")
    size = [number("--size", text) / INCH for text in texts if text.strip()]
    least, most = SIDES
    if options.size is not None and (
        len(size) != 2 or not least <= INCH * min(size) <= INCH * max(size) <= most
    ):
        raise GlissandoError(
            f"--size {options.size}: give width and height in mm, from {least:g} to {most:g}."
        )
    appearance: dict[str, Any] = {"size": (size[0], size[1])} if size else {}
    points = options.font_size
    if points is not None:
        if not 0.0 < points <= _LARGEST:
            raise GlissandoError(f"--font-size {points:g}: give points, up to {_LARGEST:g}.")
        appearance["style"] = {"font.size": points, "axes.titlesize": points}
    return appearance
