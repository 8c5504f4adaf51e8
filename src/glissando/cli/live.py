"""`glissando live`: online estimation from live sensors, with updates at a constant rate."""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shlex import quote

import numpy as np
from rich.console import Console
from rich.live import Live as Line
from rich.text import Text

from glissando.cli.browser import browser_view
from glissando.cli.interrupts import until_interrupted
from glissando.cli.outputs import require_writable
from glissando.cli.record import add_slide, further_paths, refuse_idle_slide, slide_path
from glissando.cli.say import say
from glissando.cli.shared import Commands, add_command, warn
from glissando.cli.unused_options import refuse_unused
from glissando.errors import GlissandoError
from glissando.evaluation.plausibility.monitor import PlausibilityMonitor
from glissando.hardware.capture import Rig, load_rig, simulated_rig
from glissando.hardware.capture.child_process import blocked_signals, end_with_parent
from glissando.hardware.live import LiveSession, Placement, Update
from glissando.hardware.live.addresses import SINKS, SOURCES, require_source, sink_of, source_of
from glissando.hardware.live.replanning import Replanning
from glissando.hardware.live.rig_source import RigSource
from glissando.hardware.live.sinks import Sink
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file
from glissando.model.robot import Robot
from glissando.model.slide_path import SlideLimits, SlidePath
from glissando.planning.zones import read_zone
from glissando.visualization.page.live import follow

_HELP = """\
Estimate the robot live: readings come from sources, updates of the newest shape with its confidence
go to sinks, at a steady rate. Sources and sinks combine freely, and each may be given many times.

OpenIGTLink peers (PLUS, 3D Slicer, trackers, MATLAB) send TRANSFORM, POSITION and TDATA in
millimetres; --at says where on the robot each of their devices sits. They get TDATA, TRANSFORM and
POLYDATA. An address may end in options, such as ?unit=m&axes=lps&clock=shared.
A rig's setup file is that of `glissando record`; its slide follows --slide meanwhile.

--replan has the slide of such a rig, or of a simulated one, go where a zone of the robot becomes
known best. Plans are computed beside the estimate; the slide stands when no further one comes.

A slow, dead or malicious peer delays nobody. Every reading is in the --journal before it is used;
it is a recording like any other. Every ten seconds another process looks at the newest readings;
each kind of thing that is implausible about them is a warning, once.
"""
_EXAMPLES = """\
examples:
  glissando live --source my_recording --sink csv:newest.csv --journal log
  glissando live --source slow_free_space --sink igtl-server://:18945 --view
  glissando live --robot tdcr466 --source igtl://192.168.1.7:18944 --at Base=0 \\
      --at Tip=0.466:coil --sink igtl-server://0.0.0.0:18945 --journal log --rate 60
  glissando live --source simulate --slide oscillate --sink igtl-server://:18945 --view
  glissando live --source bench.toml --slide oscillate --sink ros2 --journal log
  glissando live --source bench.toml --replan 0.62:0.68 --journal log
  glissando live --robot sliding700 --source igtl-server://:18944 --at Coil=0.7:coil:slides

Ctrl-C ends it.

exit status: 0 ended by Ctrl-C, --duration or the end of all sources; 2 a peer stayed silent, or
something given was wrong.
"""
_SIMULATED = "simulate"  # name of the source that is a simulated rig
_SOURCES = f"{SOURCES}, a rig's setup file, or {_SIMULATED}"
_RECENT = 300  # newest updates, over which the status is computed
_SAME = 0.01  # largest relative difference of lengths of one robot
_DAY = 86_400.0  # s, longest time that a slide is replanned
_PLAIN, _TERMINAL = 5.0, 0.2  # s between statuses


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    parser = add_command(commands, "live", (_HELP, _EXAMPLES), _live)
    add = parser.add_argument
    add("--robot", metavar="FILE|NAME", help="robot file or shipped robot (default: a recording's)")
    several = {"action": "append", "default": [], "metavar": "ADDRESS"}
    add("--source", **several, help=_SOURCES)  # type: ignore[arg-type]
    add("--sink", **several, help=SINKS)  # type: ignore[arg-type]
    at = "where a device sits: NAME=METRES, then :pose, :coil, :position or :gyro, and :slides"
    add("--at", action="append", default=[], metavar="NAME=M", help=at)
    add("--rate", type=float, metavar="HZ", help="updates a second (default: the robot's)")
    lag = "seconds the estimator looks back (default: four updates; 0 is a filter)"
    add("--lag", type=float, metavar="S", help=lag)
    delay = "seconds an update waits for readings of its time (default 0)"
    add("--delay", type=float, default=0.0, metavar="S", help=delay)
    add("--points", type=int, default=30, metavar="N", help="frames along the robot (default 30)")
    add("--journal", type=Path, metavar="DIR", help="new folder to record every reading in")
    add("--duration", type=float, metavar="S", help="seconds to run")
    patience = "seconds all sources may be silent (default 20)"
    add("--patience", type=float, default=20.0, metavar="S", help=patience)
    add_slide(parser, "hold")
    zone = "plan the slide in the loop so that this zone is known best; may be repeated"
    add("--replan", action="append", default=[], metavar="S0:S1[@T0:T1]", help=zone)
    add("--view", action="store_true", help="show it in a browser as it goes (needs viser)")


def _live(options: argparse.Namespace) -> int:
    with ExitStack() as stack:
        return _run(options, stack)


def _run(options: argparse.Namespace, devices: ExitStack) -> int:
    rigs = {text: _rig(text, devices) for text in options.source if _is_rig(text)}
    robot = _robot(options, rigs)
    _refuse_idle(options, list(rigs.values()))
    placements = [Placement.parse(text) for text in options.at]
    if options.journal is not None:
        require_writable(options.journal.parent)
    steered = {text: _rig_source(rig, robot, options) for text, rig in rigs.items()}
    sinks: list[Sink] = [sink_of(text) for text in options.sink]
    if options.replan:
        sinks.append(_replanning(rigs, steered, robot, options.replan))
    session = LiveSession(
        robot,
        [steered.get(text) or source_of(text, robot, placements) for text in options.source],
        sinks,
        rate=options.rate,
        lag=options.lag,
        delay=options.delay,
        points=options.points,
        journal=options.journal,
        duration=options.duration,
        patience=options.patience,
    )
    status, now = _Status(session), 0.0
    watch = PlausibilityMonitor(robot, devices.enter_context(_worker_executor()))
    with until_interrupted(), ExitStack() as stack:
        view = browser_view(robot.length, stack) if options.view else None
        stack.enter_context(status)
        stack.enter_context(session)
        for update in session:
            with blocked_signals():
                findings, now = watch.take(update.readings, update.time), update.time
            status.show(update)
            warn(findings)
            if view is not None:
                follow(view, update.smoother)
    print(status.summary())
    warn(watch.last(now))
    return 0


def _refuse_idle(options: argparse.Namespace, rigs: Sequence[Rig]) -> None:
    """Raise GlissandoError for options that have no effect on any source."""
    moves = any(rig.further or (rig.stage and not options.replan) for rig in rigs)
    without = "--replan" if options.replan else "sources without a stage"
    refuse_idle_slide(options, without, moves=moves)
    if all(_is_rig(text) or Path(text).is_dir() for text in options.source):
        refuse_unused(options, "sources that say where their sensors are", "at")


@contextmanager
def _worker_executor() -> Iterator[Executor]:
    """Executor of one worker process, which starts when the first task is submitted."""
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(1, mp_context=context, initializer=end_with_parent)
    try:
        yield executor
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def _rig_source(rig: Rig, robot: Robot, options: argparse.Namespace) -> RigSource:
    further = further_paths(options, rig)
    if not options.replan:
        return RigSource(rig, robot, slide_path(options, rig), further=further)
    unlimited = SlideLimits(1.0, 1.0, 1.0)
    lasts = SlidePath.hold(0.0, _DAY if options.duration is None else options.duration, unlimited)
    return RigSource(rig, robot, lasts, further=further, steered=True)


def _replanning(
    rigs: dict[str, Rig], sources: dict[str, RigSource], robot: Robot, zones: list[str]
) -> Replanning:
    """Sink that replans the slide of the only rig."""
    if len(rigs) != 1:
        raise GlissandoError(
            f"--replan steers the slide of a rig, and {len(rigs)} are among the sources; give one "
            f"setup file, or {_SIMULATED}."
        )
    ((text, rig),) = rigs.items()
    return Replanning(sources[text], rig, robot, [read_zone(zone) for zone in zones])


def _is_rig(text: str) -> bool:
    return text == _SIMULATED or text.endswith(".toml")


def _rig(text: str, devices: ExitStack) -> Rig:
    """Rig of a setup file, or a simulated one, which stops when the stack closes."""
    if text == _SIMULATED:
        return devices.enter_context(simulated_rig())
    return load_rig(text)


def _robot(options: argparse.Namespace, rigs: dict[str, Rig]) -> Robot:
    """Robot of --robot, else the robot named by a rig or a recording among the sources."""
    if not options.source:
        raise GlissandoError(f"A live estimate needs readings; give --source: {_SOURCES}.")
    if options.robot:
        given = load_robot(options.robot)
        for text, rig in rigs.items():
            own = load_robot(robot_file(rig.robot))
            if abs(own.length - given.length) > _SAME * own.length:
                raise GlissandoError(
                    f"--robot {options.robot} is {given.length:g} m long and the robot of {text}, "
                    f"{rig.robot}, {own.length:g} m; give a file of that robot."
                )
        return given
    for rig in rigs.values():
        return load_robot(robot_file(rig.robot))
    for folder in filter(lambda text: Path(text).is_dir(), options.source):
        if (robot := load_recording(folder).robot) is not None:
            return robot
    for text in options.source:
        require_source(text)
    raise GlissandoError("No source says which robot it is of; give --robot FILE or NAME.")


class _Status:
    """Status line of the session on stderr: updated on a terminal, else every five seconds."""

    def __init__(self, session: LiveSession) -> None:
        self._session, self._console = session, Console(stderr=True)
        self._recent: deque[Update] = deque(maxlen=_RECENT)
        self._count, self._shown = 0, time.monotonic()
        self._line: Line | None = None
        session.waiting = self._wait

    def __enter__(self) -> _Status:
        waiting = "Waiting for the first reading; Ctrl-C ends it."
        if self._console.is_terminal:
            self._line = Line(Text(waiting), console=self._console, transient=True)
            self._line.start()
        else:
            say(waiting)
        return self

    def __exit__(self, *raised: object) -> None:
        if self._line is not None:
            self._line.stop()

    def show(self, update: Update) -> None:
        """Count an update, and renew the line if it is due."""
        self._recent.append(update)
        self._count += 1
        self._renew(self._text)

    def _wait(self, why: str) -> None:
        """Show why there is no reading yet."""
        self._renew(lambda: f"Waiting for the first reading ({why}); Ctrl-C ends it.")

    def _renew(self, text: Callable[[], str]) -> None:
        if time.monotonic() - self._shown < (_TERMINAL if self._line else _PLAIN):
            return
        self._shown = time.monotonic()
        if self._line is not None:
            self._line.update(Text(text()))
        else:
            say(text())

    def _text(self) -> str:
        last, smoother = self._recent[-1], self._session.smoother
        span = last.time - self._recent[0].time
        rate = (len(self._recent) - 1) / span if span else 0.0
        latency = 1e3 * np.array([u.latency for u in self._recent])
        nis = "–" if smoother.nis is None else f"{smoother.nis:.2f}"
        parts = [
            f"{last.time:.1f} s: tip ± {float(f'{1e3 * last.std_tip:.2g}'):g} mm",
            f"{rate:.1f} Hz",
            f"latency {np.median(latency):.1f} ms, p99 {np.percentile(latency, 99):.1f} ms",
            f"innovations {nis}",
            self._losses(),
        ]
        return ", ".join(filter(None, parts)) + "".join(f"; {text}" for text in last.problems)

    def _losses(self) -> str:
        """Counts of skipped updates, dropped readings and other losses so far."""
        session = self._session
        counts = {"updates skipped": session.skipped}
        for name, why in session.smoother.dropped.items():
            counts |= {f"{name} {reason}": count for reason, count in why.items()}
        for happened in [s.counts for s in session.sources] + [s.counts for s in session.sinks]:
            counts |= {k: n for k, n in happened.items() if k not in ("heard", "connected")}
        return ", ".join(f"{n} {name}" for name, n in counts.items() if n)

    def summary(self) -> str:
        """Summary of the session, as a sentence."""
        session, losses = self._session, self._losses()
        sentence = f"{self._count} updates{f' ({losses})' if losses else ''}."
        if session.journal_folder is None:
            return sentence
        folder = quote(str(session.journal_folder))
        return f"{sentence} Journal: {folder}. Now: glissando estimate {folder} --out results"
