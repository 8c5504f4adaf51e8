"""Write docs/confidence.md: every number of that page is measured here.

Some sections need the public recordings and take minutes each. Usage: confidence.py [--page FILE]
[--outputs DIR]   (DIR/SECTION.txt, if it exists, replaces the output of a section's script)
"""

import argparse
import subprocess
import sys
from pathlib import Path

from real import SENSORS

SECTIONS = (
    "claimed",
    "invariance",
    "shapes",
    "one_moment",
    "still",
    "nodes",
    "real_slide",
    "outliers",
    "real",
    "error_parts",
)
LEARNED = "results/learned.toml"


def window(name, start, stop):
    """Options for a window of a public recording, estimated from the sensors of `real.py`."""
    folder = f"../shared/data/spacetime/{name}"
    return ["--recording", folder, "--window", str(start), str(stop), "--use", *SENSORS]


OPTIONS = {  # learning takes a minute or two and leaves its file
    "one_moment": ["--shapes", "60"],
    "still": ["--shapes", "60"],
    "real_slide": ["--robot", "tdcr466-segments", "--periods", "1", "2"],
    "real": ["--learn", LEARNED],
    "error_parts": ["--robot", LEARNED, *window("slow_free_space", 19, 29)],
}
VARIED = {
    f"{name} {start}–{stop} s": ["--robot", LEARNED, "--vary", *window(name, start, stop)]
    for name, start, stop in (
        ("slow_free_space", 19, 29),
        ("fast_contact", 10, 20),
        ("fast_contact", 20, 30),
    )
}

TEXT = """\
# Is the stated confidence true?

`python benchmarks/confidence.py` measures every number on this page and writes it.

## Claimed and observed coverage

The table gives the share of true positions inside their 95 % ellipsoid, by robot file and
recording. The target is 88 to 99 % for a shipped file, and 85 to 99.5 % for a file of `glissando
robot new`.

```
python benchmarks/claimed.py
python benchmarks/claimed.py --recording FOLDER --robot FILE --window T0 T1
```

{claimed}

In the last seconds of `fast_contact` the robot moves little, and all samples are inside every
ellipsoid. The rod of `extensible` begins compressed to 0.16 of its length and has a tracker at
the end of each third. A file that states this stretch has true confidence. A file with the
default stretch of 5 % excludes the actual shapes, and its other settings, however wide, cannot
compensate for that. In this case `estimate` warns that its confidence is false: more than a tenth
of a stream's readings lie farther from the estimate than one in a thousand should. Of a stream
with a robust loss, a reading counts only if the next reading is off in a similar direction, which
distinguishes a contradiction from single outliers.

## Nodes, duration and confidence

A coil reads the tip of a still robot. The table gives the standard deviation of position at
mid-length and mid-recording, and its change when a quantity is doubled that adds no information
there.

{invariance}

## Shapes of an independent solver

{shapes}

## Shapes of one moment

If a robot of two segments bends widely and only its tip is read, very different shapes may
explain the readings of one moment. `estimate` finds one of these shapes, and its covariance
describes the errors around it. `estimate_static` seeks others, from twelve shapes drawn from
the prior, where the stated direction of the body has a standard deviation above 0.1 rad. It
returns the likeliest and warns of shapes of which others are probable; `others` has their
probability. It does not find all: where the position of the tip alone is read, belief is curved
as well, and some of the shapes that it does not name are far off.
[`sample_static`](api/index.md) draws a hundred shapes that explain the readings in one to two
seconds; their distribution includes the ambiguity. A second sensor, or one that
slides, can resolve it.

In the table, true shapes are drawn from the prior of `tdcr466-segments`, and read to 1 mm (and 10
mrad for a coil's direction). Each cell gives the share inside 95 %, and the mean squared error over
the stated variance, which is 1 for true confidence. `python benchmarks/one_moment.py --shapes 60`
prints it.

{one_moment}

### A still robot read at its tip

The same shapes are held still for two seconds, and a coil at the tip is read at 40 Hz. A search
from rest may end in a motion with a turn more or less. Where the robot is widely bent between two
read places and that search is not quick, `estimate` also starts from static shapes of one moment,
found from rest and from shapes drawn from the prior, and follows each of them to the other moments.
It returns the likeliest motion, and warns of others that are probable. The table gives the position
of the middle: the share inside 95 %, the mean squared error over the stated variance, and the share
of shapes more than 100 mm off. A warning says that others are probable or that the search has not
converged. `python benchmarks/still.py --shapes 60` prints it.

{still}

## Accuracy and cost of nodes

{nodes}

The separable prior is the same process for any number of nodes. Between time nodes, however, the
covariance is that of an interpolation between the nodes, which is large where a step is long for
the prior. Therefore `tdcr466-segments` has 30 nodes a second, and `estimate` and `check`
[warn](guard.md#between-time-nodes) if there are too few.

## A sliding sensor on real motion

No public recording has a sliding sensor, so one is emulated. The real robot carries five motion
capture bodies. At each time, the body nearest to a virtual place that moves along the robot is read
as a coil of five degrees of freedom, and the other bodies are truth. In the arm `fixed` this place
is the tip; in `oscillating` it moves over the last quarter of the body; in `traverse`, over all but
the base. Two arms are compared on truth that neither of them reads.

{real_slide}

The variation of strain along the second segment was chosen on `slow_free_space`, where the segment
bends most towards its tip; `fast_contact` is reported. A prior that is wide enough for impacts is
underconfident in slow motion: there the errors with a sliding coil are half to two thirds of the
standard deviations.

## Outliers

{outliers}

## The real robot

{real}

The robot file also accounts for these effects:

- The tracker was polled faster than it measures, so its stamps are up to 20 ms late, at a tip that
  moves at 1.6 m/s (`rate`).
- The coil at the tip is tilted by some degrees (`--joint`).
- The tendons pull discs and bodies down the backbone, by 8 mm at mid-length (an axial set).
- The distortion of the tracker's field drifts.

It does not estimate delays of the gyroscopes, because no window changed them from their stated
values.

**How far to trust the table.** The first two windows are not a held-out test. Some hundred
settings, first of priors on strain and then of the rod, were judged on them before this file was
learned. The effects above were found from both recordings and their truth, except the evenly
spaced stamps, which need no truth. Two choices do not depend on these windows: that rest counts
once is a general argument, and the first recording alone shows the weight ("no weight" in the
last table). No choice was made on the last four seconds. The weights and the drifts were learned
in free space until convergence. Their initial values, the moments of tendons, the forces of
contacts, sets, torsional stiffness, noise, time scale and the time grid were set by hand. Little
is published about the robot's body; a nitinol wire of 1 mm was assumed, and the readings depend
only on ratios to its stiffness.

**Remaining errors.** With the frame and mounts estimated from slow motion, tracker and motion
capture disagree by some millimetres at the tip in the first two windows. Motion capture is 20 ms
late in `slow_free_space` and 2 ms in `fast_contact`; this delay differs between recordings, so it
is not corrected. From 20 to 30 s the impact disturbs the tracker.

## What the errors of the learned file are

`python benchmarks/error_parts.py` separates the errors by body and direction, in each body's own
axes. It then removes errors that may belong to the truth, by fitting a delay, a rigid transform
or a constant of each body. Such a fit removes at most what belongs to the truth and part of the
estimate's own error, so the reduction is an upper bound; it is applied nowhere else. On the
recording from which the file was learned, 19 to 29 s:

{error_parts}

`--vary` scales the prior's settings one by one; factors of moments, loads, forces and sets apply to
standard deviations. Each cell gives the position RMSE in millimetres and the share inside 95 %:

{varied}
"""


def measured(section, outputs):
    """Output of a section's script, from an earlier run if there is one."""
    file = outputs / f"{section}.txt" if outputs else None
    if file and file.exists():
        return file.read_text(encoding="utf-8").strip()
    return printed(section, OPTIONS.get(section, []))


def printed(section, options):
    """Output of a section's script with options."""
    script = Path(__file__).with_name(f"{section}.py")
    command = [sys.executable, "-W", "ignore", str(script), *options]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def varied(outputs):
    """Errors and coverage with numbers of the learned prior changed, a column per window."""
    file = outputs / "varied.txt" if outputs else None
    if file and file.exists():
        return file.read_text(encoding="utf-8").strip()
    columns = [dict(judged(printed("error_parts", each))) for each in VARIED.values()]
    rows = [f"| {prior} | {' | '.join(c[prior] for c in columns)} |" for prior in columns[0]]
    heads = [f"| prior | {' | '.join(VARIED)} |", "|---" * (len(VARIED) + 1) + "|"]
    return "\n".join([*heads, *rows])


def judged(table):
    """Yield prior, and its error and coverage, of each row that `error_parts.py --vary` prints."""
    for line in table.splitlines()[2:]:
        prior, error, inside, _, evidence = (cell.strip() for cell in line.strip("| ").split("|"))
        yield prior, f"{error}, {inside}" + " (no convergence)" * ("not" in evidence)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/confidence.md"))
    parser.add_argument("--outputs", type=Path, metavar="DIR")
    options = parser.parse_args()
    found = {section: measured(section, options.outputs) for section in SECTIONS}
    found["varied"] = varied(options.outputs)
    options.page.write_text(TEXT.format(**found), encoding="utf-8")
    print(options.page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
