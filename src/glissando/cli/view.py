"""`glissando view`: the robot over time with its uncertainty, as a page or live in a browser."""

from __future__ import annotations

import argparse
from pathlib import Path

from glissando.cli.outputs import PAGE, require_replaceable, require_writable
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import Commands, add_choices, add_command, posterior_shown
from glissando.cli.unused_options import refuse_unused
from glissando.io.atomic import write_text
from glissando.visualization.page import page, scene_of, subtitle
from glissando.visualization.page.live import play

_HELP = """\
Show the robot over time in a browser: its shape with the 95 % tube and ellipsoids, the sliding
sensor, truth, and confidence along the body as colour, with a slider for time. Beside it stands the
tube that the robot file promises, if `glissando check --store-tube` has written one.

The page is one file that works without a network. RECORDING is estimated first; POSTERIOR is a
posterior.nc of an earlier estimate, or the folder it is in, and takes sensors and truth from
--recording.
"""
_EXAMPLES = """\
examples:
  glissando view results --recording my_recording
  glissando view my_recording --window 19 29 --html slide.html
  glissando view results --live

exit status: 0 done; 1 the estimate did not converge; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "view", (_HELP, _EXAMPLES), _view)
    add = parser.add_argument
    add("target", type=Path, metavar="RECORDING|POSTERIOR", help="folder, or a posterior.nc")
    add("--recording", type=Path, metavar="FOLDER", help="sensors and truth of a posterior")
    add_choices(parser)
    page_help = "page to write (default: view.html)"
    add("--html", type=Path, metavar="FILE", default=Path("view.html"), help=page_help)
    add("--live", action="store_true", help="play it from a server instead (needs viser)")
    add("--port", type=int, default=8080, metavar="N", help="of the live server (default 8080)")


def _view(options: argparse.Namespace) -> int:
    if options.live:
        refuse_unused(options, "--live, which writes no page", "html")
    else:
        refuse_unused(options, "a view without --live", "port")
        require_writable(options.html.parent)
        inputs = options.target, options.recording, options.robot
        require_replaceable("--html", options.html, *inputs, begins=PAGE)
    shown = posterior_shown(options)
    posterior = shown.posterior
    window = tuple(options.window) if options.window else None
    with working("evaluating the posterior") as work:
        scene = scene_of(
            posterior,
            shown.readings,
            shown.truth,
            window=window,
            tube=shown.robot.tube if shown.robot else None,
            progress=work.update,
        )
    if options.live:
        play(scene, options.port)
    else:
        write_text(options.html, page(scene, shown.title, subtitle(posterior, scene)))
        print(f"Wrote {options.html}; open it in a browser.")
    if shown.complaint:
        say(f"glissando: {shown.complaint}")
    return 0 if posterior.solve.converged else 1
