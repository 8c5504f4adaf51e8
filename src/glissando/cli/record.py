"""`glissando record`: recording of an experiment with all devices of a rig."""

from __future__ import annotations

import argparse
import shutil
import time
from contextlib import ExitStack
from pathlib import Path
from shlex import quote

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from glissando.cli.outputs import require_writable
from glissando.cli.progress import working
from glissando.cli.say import say
from glissando.cli.shared import Commands, add_command, findings_in, warn
from glissando.cli.simulate import add_channel
from glissando.cli.unused_options import refuse_unused
from glissando.errors import DeviceError, GlissandoError
from glissando.hardware.capture import (
    FurtherStage,
    Progress,
    Rig,
    capture,
    load_rig,
    simulated_rig,
    write_recording,
)
from glissando.hardware.capture.online import OnMessage, live_estimate
from glissando.io.atomic import require_new, write_text
from glissando.io.session_log import read_session
from glissando.io.session_recording import LOG
from glissando.model.slide_path import read_slide
from glissando.simulation import SlideLimits, SlidePath
from glissando.visualization.page.live import Live as BrowserView
from glissando.visualization.page.live import follow

_HELP = """\
Run an experiment: the slide follows its path while tracker, slide and motion capture are recorded
together. The raw log, session.mcap, is whole up to the last second whatever happens; when the slide
stands again it becomes a recording in the same folder, which `estimate` takes.

--simulate starts every device as a process of its own, for a rig that one does not have.
"""
_EXAMPLES = """\
examples:
  glissando record --simulate --shape S --out session
  glissando record --simulate --live --out session
  glissando record --setup bench.toml --slide oscillate --cycles 3 --stroke 0.06 --speed 0.024 \\
      --out session
  glissando record --setup bench.toml --slide hold --duration 15 --out fixed
  glissando record --setup bench.toml --slide calibrate --out session
  glissando calibrate session --out calibration.toml
  glissando estimate session --out results

Ctrl-C stops the slide and keeps what was recorded.

exit status: 0 done; 1 stopped early; 2 a device or something given was wrong.
"""
_REFRESH = 0.2  # s between updates of the table
_DAY = 86_400.0  # longest duration of a path, s
_OF_A_PATH = ("cycles", "stroke", "speed")
_WITHOUT_EFFECT = {"oscillate": (), "calibrate": ("cycles", "speed")}  # by --slide


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "record", texts, _record)
    add = parser.add_argument
    add("--setup", type=Path, metavar="FILE", help="the rig's devices and where its coils are")
    add("--simulate", action="store_true", help="start simulated devices instead")
    add("--robot", default="sliding700", metavar="FILE|NAME", help="that is simulated")
    add("--shape", default="S", metavar="NAME|FILE", help="of the simulated robot (default S)")
    add("--seed", type=int, default=0, metavar="N", help="of the simulated noise (default 0)")
    faults = "what goes wrong with the simulated tracker: unplug=5,replug=7"
    add("--faults", default="", metavar="NAME=NUMBER,…", help=faults)
    add_channel(parser)
    add_slide(parser, "oscillate")
    add("--duration", type=float, metavar="S", help="of hold (15) and calibrate (45)")
    add("--live", action="store_true", help="show the shape in a browser as it goes (needs viser)")
    add("--out", type=Path, required=True, metavar="SESSION", help="new folder to write")


def add_slide(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the options that choose the slide's path, except its duration."""
    add = parser.add_argument
    slides = f"oscillate, calibrate, hold (where it stands) or a CSV of plan (default {default})"
    add("--slide", default=default, metavar="NAME|FILE", help=slides)
    add("--cycles", type=int, default=3, metavar="N", help="there and back (default 3)")
    add("--stroke", type=float, metavar="M", help="of a cycle (default: the stage's)")
    add("--speed", type=float, metavar="M/S", help="of the slide (default: the stage's)")


def _record(options: argparse.Namespace) -> int:
    if bool(options.setup) == options.simulate:
        raise GlissandoError("Give --setup FILE for a real rig, or --simulate for none.")
    real = load_rig(options.setup) if options.setup else None
    if real:
        refuse_unused(options, "--setup", "robot", "shape", "seed", "faults", "channel")
    moves = real is None or bool(real.stage or real.further)
    refuse_idle_slide(options, "a rig without a stage", moves=moves)
    if moves and options.slide not in ("hold", "calibrate"):
        refuse_unused(options, f"--slide {options.slide}", "duration")
    require_writable(options.out.parent)
    require_new(options.out, GlissandoError)
    if options.out.exists():
        options.out.rmdir()
    with ExitStack() as stack:
        if real:
            rig = real
        else:
            chosen = options.robot, options.shape, options.seed, options.faults
            rig = stack.enter_context(simulated_rig(*chosen, channel=options.channel))
        path = slide_path(options, rig)
        try:
            on_message = None
            if options.live:
                view = live_estimate(rig, BrowserView, follow)
                address, on_message = stack.enter_context(view)
                say(f"Look at {address}")
            further = further_paths(options, rig)
            _capture_shown(rig, path, further, options.out, on_message)
            status = 0
        except KeyboardInterrupt:
            if not _has_messages(options.out):
                shutil.rmtree(options.out, ignore_errors=True)
                print("Stopped before anything was recorded.")
                return 1
            print("Stopped; what was recorded is kept.")
            status = 1
        except DeviceError:
            if (options.out / LOG).exists():
                _finish_recording(rig, options, quietly=True)
            raise
    _finish_recording(rig, options)
    return status


def refuse_idle_slide(options: argparse.Namespace, without: str, *, moves: bool) -> None:
    """Refuse options of the slide that have no effect.

    Args:
        options: Options of the command.
        without: Reason for the message if `moves` is false, such as "a rig without a stage".
        moves: Whether there is a stage that follows the slide's path.

    Raises:
        GlissandoError: An option without effect is given.
    """
    if not moves:
        refuse_unused(options, without, "slide", *_OF_A_PATH)
    else:
        refuse_unused(
            options, f"--slide {options.slide}", *_WITHOUT_EFFECT.get(options.slide, _OF_A_PATH)
        )


def further_paths(options: argparse.Namespace, rig: Rig) -> dict[str, SlidePath]:
    """Paths of the rig's further stages by name, of the kind of --slide, within their limits."""
    return {one.name: slide_path(options, rig, one) for one in rig.further}


def slide_path(
    options: argparse.Namespace, rig: Rig, further: FurtherStage | None = None
) -> SlidePath:
    """Path of a stage by --slide and its options, within the limits of the stage.

    Args:
        options: Options of the command.
        rig: The rig.
        further: One of the rig's further stages; None for its first.

    Raises:
        GlissandoError: The options describe no possible path.
    """
    stage, name = (further.stage, further.name) if further else (rig.stage, "")
    limits = SlideLimits(1.0, 1.0, 1.0)
    if stage is not None:
        limits = SlideLimits(stage.stroke[1], stage.speed, stage.acceleration)
    duration = options.duration
    if duration is not None and duration > _DAY:
        raise GlissandoError(f"--duration is {duration:g} s; give a day, {_DAY:g} s, at most.")
    if options.slide == "hold" or stage is None:
        where = (further or rig).standing_travel
        return SlidePath.hold(where, 15.0 if duration is None else duration, limits)
    stroke = limits.stroke if options.stroke is None else options.stroke
    if options.slide == "oscillate":
        return SlidePath.oscillate(options.cycles, stroke, limits, speed=options.speed)
    if options.slide == "calibrate":
        return SlidePath.calibrate(45.0 if duration is None else duration, stroke, limits)
    if not Path(options.slide).is_file():
        raise GlissandoError(
            f"There is no slide named {options.slide!r} and no such file; give oscillate, "
            f"calibrate, hold or a CSV file."
        )
    drawn_out = next((c.arclength for c in rig.coils if c.slides and c.slide == name), None)
    return read_slide(Path(options.slide), limits, drawn_out)


def _capture_shown(
    rig: Rig,
    path: SlidePath,
    further: dict[str, SlidePath],
    folder: Path,
    on_message: OnMessage | None,
) -> None:
    """Run the experiment while stderr shows a live table, or lines if it is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        with working("recording") as work:

            def line(progress: Progress) -> None:
                into = time.monotonic() - progress.began
                count = sum(dict(progress.count).values())
                work.update(into, progress.total, f"{count:,} messages")

            capture(rig, path, folder, further=further, on_progress=line, on_message=on_message)
        return
    with Live(console=console, auto_refresh=False, transient=True) as live:
        shown = 0.0

        def refresh(progress: Progress) -> None:
            nonlocal shown
            if time.monotonic() - shown > _REFRESH:
                live.update(_table(progress), refresh=True)
                shown = time.monotonic()

        capture(rig, path, folder, further=further, on_progress=refresh, on_message=on_message)


def _table(progress: Progress) -> Table:
    """Table of the present progress, from copies, as the devices' threads write to it."""
    into = min(time.monotonic() - progress.began, progress.total)
    table = Table("stream", "Hz", "messages", "last", title=f"{into:.0f} of {progress.total:.0f} s")
    for topic, count in dict(progress.count).items():
        last = escape(progress.last.get(topic, ""))
        table.add_row(escape(topic), f"{progress.rate(topic):.1f}", str(count), last)
    for device, problem in dict(progress.problems).items():
        table.add_row(escape(device), "", escape(problem), "")
    return table


def _has_messages(folder: Path) -> bool:
    """Whether the session log in a folder has any message."""
    log = folder / LOG
    return log.exists() and any(topic.messages for topic in read_session(log).topics.values())


def _finish_recording(rig: Rig, options: argparse.Namespace, *, quietly: bool = False) -> None:
    """Write the session log as a recording and print a summary.

    If `quietly`, after a device failed, delete a log without messages, and report on stderr.
    """
    folder = options.out
    if quietly and not _has_messages(folder):
        shutil.rmtree(folder)  # nothing began
        return
    session = read_session(folder / LOG)
    whole = f"glissando: what was recorded is kept in {folder / LOG}"
    try:
        warnings = write_recording(session, rig, folder)
    except GlissandoError:
        say(f"{whole}; glissando estimate {quote(str(folder))} reads it.")
        if not quietly:
            raise
        return
    if options.setup:
        write_text(folder / "setup.toml", options.setup.read_text(encoding="utf-8"))
    if quietly:
        say(f"{whole} and beside it.")
        return
    counts = ", ".join(f"{len(t.messages)} {name}" for name, t in session.topics.items())
    print(f"Wrote {folder}: {counts}. Now: glissando estimate {quote(str(folder))} --out results")
    for warning in warnings:
        print(f"  but {warning}")
    warn(findings_in(folder))
