"""Fuzz test of all parsers: damaged files and messages must give a result or a clear error.

Each parser reads randomly damaged samples in a monitored process. A result, or one of the package's
own errors, is correct; a traceback, a hang (more than 10 s of processor time), a crash of the
process, more than 1 GB of additional memory, or a file written outside the output folder is a
failure, and is printed with its number.

Usage: mutations.py [--count N] [--seed S] [--jobs J] [--parser NAME,…]
                    [--recording FOLDER] [--json FILE]
       mutations.py --parser NAME --only K     # one mutation again, with its traceback
"""

import argparse
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando.errors import GlissandoError, NoShapeError
from mutation_kinds import pick
from mutation_parsers import parsers

HANG, MEMORY = 10.0, 1.0  # s of processor time, GB
BUSY = 6.0  # largest ratio of wall-clock to processor time on a busy machine
WELL = ("answer", "sentence")
ENDS = (*WELL, "traceback", "hang", "death", "memory", "outside")
_CACHES = (
    os.environ.get("GLISSANDO_CACHE", "/dev/null"),
    str(Path.home() / ".cache" / "glissando"),
)
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_OUTSIDE = {"allowed": (), "seen": []}
_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")


def _audit(event, args):
    """Audit hook that records changes of files outside the allowed folders."""
    if not _OUTSIDE["allowed"] or (event != "open" and event not in _CHANGES):
        return
    if event == "open" and not (isinstance(args[2], int) and args[2] & _WRITES):
        return
    count = 1 + (event == "os.rename")
    for path, folder in zip(args[:count], (*[-1] * count, *args[count:])[-count:], strict=True):
        if isinstance(path, str | bytes | os.PathLike):
            base = f"/proc/self/fd/{folder}" if event != "open" and folder >= 0 else ""
            place = os.path.realpath(os.path.join(base, os.fsdecode(path)))
            if not place.startswith(_OUTSIDE["allowed"]):
                _OUTSIDE["seen"].append(f"{event} {place}")


sys.addaudithook(_audit)


@dataclass
class Tally:
    """Outcomes of the mutations of one parser."""

    counts: Counter = field(default_factory=Counter)
    longest: float = 0.0
    memory: float = 0.0
    notes: list = field(default_factory=list)

    def add(self, number, end, seconds, gigabytes, note):
        """Count one outcome."""
        self.counts[end] += 1
        self.longest, self.memory = max(self.longest, seconds), max(self.memory, gigabytes)
        if end not in WELL:
            self.notes.append(f"{number}: {end}: {note}")


def _peak():
    """Largest resident memory since `_clear_peak`, GB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return float(line.split()[1]) / 1e6
    return 0.0


def _clear_peak():
    Path("/proc/self/clear_refs").write_text("5")


def mutated(parser, seed, number):
    """Damaged files of the mutation with a number."""
    rng = np.random.default_rng([seed, number])
    return parser.mutate(rng, pick(rng, parser.samples))


def tried(parser, files, place):
    """Read files; returns outcome, processor time (s), additional memory (GB) and a note."""
    folder, out = place / "in", place / "out"
    if "line" not in files:
        for path in (folder, out):
            shutil.rmtree(path, ignore_errors=True)
            path.mkdir(parents=True)
        for name, data in files.items():
            (folder / name).parent.mkdir(exist_ok=True, parents=True)
            (folder / name).write_bytes(data)
    _clear_peak()
    before, note, start, used = _peak(), "", time.monotonic(), time.process_time()
    _OUTSIDE.update(allowed=(str(out), "/dev/null", *_CACHES), seen=[])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parser.read(files, folder, out)
        end = "answer"
    except (GlissandoError, NoShapeError) as problem:
        end, note = "sentence", str(problem)
    except Exception as problem:
        where = traceback.extract_tb(problem.__traceback__)
        inner = [f for f in where if "/glissando/" in f.filename] or where
        at = f"{Path(inner[-1].filename).name}:{inner[-1].lineno}"
        end, note = "traceback", f"{at} {type(problem).__name__}: {problem}"[:200]
        if os.environ.get("SHOW"):
            traceback.print_exc()
    waited, seconds = time.monotonic() - start, time.process_time() - used
    _OUTSIDE["allowed"] = ()
    gigabytes = max(_peak() - before, 0.0)
    if _OUTSIDE["seen"]:
        end, note = "outside", _OUTSIDE["seen"][0]
    elif max(seconds, waited / BUSY) > HANG and end in WELL:
        end, note = "hang", f"{seconds:.0f} s of processor time, {waited:.0f} s"
    elif gigabytes > MEMORY and end in WELL:
        end, note = "memory", f"{gigabytes:.1f} GB"
    return end, seconds, gigabytes, note


def _serve(parser, seed, numbers, place, pipe):
    """Try mutations by number one after the other, and report each through a pipe."""
    here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (here + (4 << 30),) * 2)
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        for sample in parser.samples:
            tried(parser, sample, place)  # the first run compiles kernels into the cache
            end, *_, note = tried(parser, sample, place)
            if end not in ("answer", "hang"):
                raise RuntimeError(f"A sound {parser.name} ends in a {end}: {note}")
        for number in numbers:
            end, *rest = tried(parser, mutated(parser, seed, number), place)
            os.write(pipe, (json.dumps([number, end, *rest]) + "\n").encode())


def run(parser, seed, count, place):
    """Run a parser's mutations; a process that hangs or crashes is replaced by a new one."""
    tally, number = Tally(), 0
    while number < count:
        ours, theirs = os.pipe()
        child = os.fork()
        if not child:
            os.close(ours)
            try:
                _serve(parser, seed, range(number, count), place, theirs)
            except BaseException:
                traceback.print_exc(file=sys.__stderr__)
                os._exit(1)
            os._exit(0)
        os.close(theirs)
        number = _follow(tally, ours, child, number)
        os.close(ours)
    return tally


def _follow(tally, pipe, child, number):
    """Receive reports until the process ends; returns the next number."""
    buffer = b""
    while True:
        ready = select.select([pipe], [], [], BUSY * HANG)[0]
        data = os.read(pipe, 1 << 16) if ready else b""
        if not data:
            break
        *lines, buffer = (buffer + data).split(b"\n")
        for line in lines:
            report = json.loads(line)
            tally.add(*report)
            number = report[0] + 1
    if ready:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code > 0:
            raise RuntimeError("The program that mutates failed itself; see above.")
        if code < 0:
            tally.add(number, "death", 0.0, 0.0, f"signal {-code}")
        return number + (code < 0)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    tally.add(number, "hang", BUSY * HANG, 0.0, "killed")
    return number + 1


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--count", type=int, default=1000, help="mutations, shared by the parsers evenly")
    add("--seed", type=int, default=0)
    add("--parser", type=lambda text: text.split(","), default=[])
    add("--recording", type=Path, help="to damage beside a simulated one")
    add("--only", type=int, help="the number of one mutation")
    add("--jobs", type=int, default=1, help="parsers at once")
    add("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(os.path.realpath(scratch))
        (scratch / "samples").mkdir()
        known = parsers(scratch / "samples", options.recording)
        chosen = [p for p in known if not options.parser or p.name in options.parser]
        if options.only is not None:
            os.environ["SHOW"] = "1"
            print(
                tried(chosen[0], mutated(chosen[0], options.seed, options.only), scratch / "place")
            )
            return 0
        each = -(-options.count // sum(one.share for one in chosen))

        def watched(one):
            began = time.monotonic()
            count = max(round(each * one.share), 1)
            tally = run(one, options.seed, count, scratch / one.name.replace(" ", "-"))
            print(f"{one.name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
            return one.name, tally

        with ThreadPoolExecutor(options.jobs) as pool:
            tallies = dict(pool.map(watched, chosen))
    for name, tally in tallies.items():
        for note in tally.notes[:12]:
            print(f"{name} {note}")
    print_table(tallies)
    if options.json:
        options.json.write_text(json.dumps(as_json(tallies, options), indent=1) + "\n")
    return int(any(t.counts[e] for t in tallies.values() for e in ENDS if e not in WELL))


def as_json(tallies, options):
    """Results as a dictionary, from which `hostile_page.py` writes the page."""
    rows = [
        {"parser": name, **{e: t.counts[e] for e in ENDS}, "longest_s": t.longest,
         "memory_gb": t.memory}
        for name, t in tallies.items()
    ]  # fmt: skip
    return {"seed": options.seed, "asked": options.count, "rows": rows}


def print_table(tallies):
    """Print a row per parser."""
    print(f"{'parser':20}" + "".join(f"{e:>10}" for e in ENDS) + "  longest s   more GB")
    for name, t in tallies.items():
        cells = "".join(f"{t.counts[e]:10}" for e in ENDS)
        print(f"{name:20}{cells}{t.longest:11.2f}{t.memory:10.2f}")
    total = sum((t.counts for t in tallies.values()), Counter())
    print(f"{'all':20}" + "".join(f"{total[e]:10}" for e in ENDS))


if __name__ == "__main__":
    sys.exit(main())
