"""Whether damaged recordings, robot files and posteriors end in a sentence, soon and in bounds.

Mutates cells, keys, numbers, lines and bytes at random; reads what comes out, looks at it as a
command does before an estimate, and estimates every K-th that passes. Anything but an answer or
one of the package's own errors is a traceback, and is printed with the mutation's seed.

Usage: mutations.py --recording FOLDER [--robot FILE] [--count N] [--estimate-every K] [--seed S]
"""

import argparse
import os
import resource
import shutil
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando.errors import GlissandoError
from glissando.evaluation.plausibility.examine import examine_recording
from glissando.evaluation.run import checked_window, chosen_streams, run_estimate
from glissando.io.netcdf import load_posterior, save_posterior
from glissando.io.recording import load_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file

ROWS = 60  # of each stream that are kept: damage does not need many
NUMBERS = (
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e-308",
    "nan",
    "inf",
    "1e9",
    "-0.0",
    "1e-9",
    "3",
    "",
    "x",
    "true",
    "[]",
    "1e400",
)


def mutated_number(rng, text):
    """Another number, or something that is none, in the place of one."""
    if rng.random() < 0.5:
        return str(rng.choice(NUMBERS))
    try:
        return repr(float(text) * float(10.0 ** rng.integers(-6, 7)) * rng.choice([1.0, -1.0]))
    except (ValueError, OverflowError):
        return str(rng.choice(NUMBERS))


def mutated_table(rng, text):
    """A CSV file with cells, columns or lines damaged."""
    lines = text.splitlines()
    for _ in range(rng.integers(1, 4)):
        kind, at = rng.integers(7), int(rng.integers(len(lines)))
        cells = lines[at].split(",")
        column = int(rng.integers(len(cells)))
        if kind <= 2:
            cells[column] = mutated_number(rng, cells[column])
            lines[at] = ",".join(cells)
        elif kind == 3:  # a whole column in another unit
            factor = float(rng.choice([1e3, 1e-3, 1e6, -1.0, 57.3, 0.0, 1e200]))
            for k in range(1, len(lines)):
                parts = lines[k].split(",")
                try:
                    parts[column] = repr(float(parts[column]) * factor)
                except (ValueError, IndexError):
                    continue
                lines[k] = ",".join(parts)
        elif kind == 4:
            lines = lines[:at] + lines[at + int(rng.integers(1, len(lines) + 1)) :]
        elif kind == 5:
            lines[at:at] = lines[at : at + int(rng.integers(1, 20))]
        else:
            rng.shuffle(cells)
            lines[at] = ",".join(cells)
        if not lines:
            break
    return "\n".join(lines) + "\n"


def mutated_toml(rng, text):
    """A TOML file with numbers, keys or lines damaged."""
    lines = text.splitlines()
    for _ in range(rng.integers(1, 3)):
        at = int(rng.integers(len(lines)))
        key, equals, value = lines[at].partition("=")
        kind = rng.integers(5)
        if kind <= 2 and equals:
            parts = value.strip().strip("[]").split(",")
            k = int(rng.integers(len(parts)))
            parts[k] = mutated_number(rng, parts[k].strip())
            inner = ", ".join(parts)
            lines[at] = f"{key}= [{inner}]" if "[" in value else f"{key}= {inner}"
        elif kind == 3:
            del lines[at]
        else:
            lines.insert(int(rng.integers(len(lines) + 1)), lines[at])
        if not lines:
            break
    return "\n".join(lines) + "\n"


def mutated_bytes(rng, data):
    """Bytes with some changed, or cut short."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 30)):
        out[int(rng.integers(len(out)))] = int(rng.integers(256))
    return bytes(out[: rng.integers(len(out))]) if rng.random() < 0.2 else bytes(out)


def shortened(source, folder):
    """A copy of a recording with the first rows of each stream."""
    folder.mkdir()
    for file in source.iterdir():
        if file.suffix == ".csv":
            lines = file.read_text().splitlines()[: ROWS + 2]
            (folder / file.name).write_text("\n".join(lines) + "\n")
        elif file.suffix == ".toml":
            shutil.copy(file, folder / file.name)


def looked_at(folder, robot, estimates):
    """Read a recording as a command does; whether it came to an estimate."""
    recording = load_recording(folder)
    robot = robot or recording.robot
    if robot is None:
        return
    window = checked_window(recording, None)
    readings, truth, _ = chosen_streams(recording, robot, window, None, None)
    findings = examine_recording(recording, robot, readings, truth, window)
    if any(f.refusal for f in findings):
        raise GlissandoError(findings[0].sentence)
    robot.grid(*window)
    if estimates:
        run_estimate(recording, robot, window=None, use=None, truth=None)


class Tally:
    """Counts answers, errors and tracebacks, and the longest time."""

    def __init__(self):
        self.counts, self.longest, self.tracebacks = Counter(), 0.0, []

    def run(self, what, seed, function, *arguments):
        """Call a function and count how it ends."""
        start = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                function(*arguments)
            self.counts[what, "answers"] += 1
        except GlissandoError:
            self.counts[what, "sentences"] += 1
        except Exception as problem:
            self.counts[what, "tracebacks"] += 1
            self.tracebacks.append(f"{what} seed {seed}: {type(problem).__name__}: {problem}")
        self.longest = max(self.longest, time.process_time() - start)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recording", type=Path, required=True)
    parser.add_argument("--robot", default=None)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--estimate-every", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    tally = Tally()
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        base = scratch / "base"
        shortened(options.recording, base)
        robot = load_robot(options.robot) if options.robot else load_recording(base).robot
        shipped = robot_file(options.robot or robot.name).read_text()
        run = run_estimate(load_recording(base), robot, window=None, use=None, truth=None)
        save_posterior(run.posterior, scratch / "posterior.nc")
        saved = (scratch / "posterior.nc").read_bytes()
        files = sorted(base.iterdir())
        for k in range(options.count):
            rng = np.random.default_rng([options.seed, k])
            if k % 10 < 7:
                file = files[rng.integers(len(files))]
                text = file.read_text()
                mutate = mutated_toml if file.suffix == ".toml" else mutated_table
                file.write_text(mutate(rng, text))
                every = options.estimate_every
                estimates = bool(every) and k % every == 0
                tally.run(
                    "recording", k, looked_at, base, robot if options.robot else None, estimates
                )
                file.write_text(text)
            elif k % 10 < 9:
                (scratch / "robot.toml").write_text(mutated_toml(rng, shipped))
                tally.run("robot", k, lambda: load_robot(scratch / "robot.toml").grid(0.0, 10.0))
            else:
                (scratch / "damaged.nc").write_bytes(mutated_bytes(rng, saved))
                tally.run("posterior", k, load_posterior, scratch / "damaged.nc")
    for line in tally.tracebacks:
        print(line[:300])
    for (what, end), count in sorted(tally.counts.items()):
        print(f"{what}: {count} {end}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"longest {tally.longest:.2f} s of CPU, peak {peak:.2f} GB")


if __name__ == "__main__":
    main()
