"""The real robot: learned on one recording, evaluated on others, with the page's two commands.

`--learn FILE` learns the robot file first, in a minute or two; `--learned FILE` evaluates an
existing one. Usage: real.py [--data FOLDER of public recordings] [--learn FILE | --learned FILE]
[--recording FOLDER [--window T0 T1]] [--json]
"""

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np

from glissando import GlissandoError, load_robot
from glissando.evaluation.consistency import check
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import run_estimate
from glissando.io.recording_folder import load_recording
from script import run, say

DATA = Path("../shared/data/spacetime")
SENSORS = ["aurora0", "aurora1", "gyro_mid", "gyro_ee"]
TUNED_ON = ("slow_free_space", (19.0, 45.0))
REPORTED_ON = (
    ("fast_contact", (10.0, 20.0), 8.5, 4.1),
    ("fast_contact", (20.0, 30.0), 11.3, 5.6),
    ("fast_contact", (30.0, 34.0), "–", "–"),
)  # window, and position (mm) and rotation (deg) of the reference implementation
LEARN = (
    "glissando learn {tuned} --window 0 45 --robot {begin} "
    "--truth vicon0,vicon1,vicon2,vicon3,vicon4 --joint "
    "--only 'mass,spread linear,correlation' --out {out}"
)
ESTIMATE = (
    "glissando estimate {data}/fast_contact --window 10 20 --robot learned.toml "
    "--use aurora0,aurora1,gyro_mid,gyro_ee --out results"
)
TEXT = """\
The robot file was learned on `{tuned}` with all motion capture as truth. The frame of motion
capture, the mounts of its bodies and the mount of the coil at the tip were estimated on the same
recording and then fixed. The table gives the errors on `fast_contact`, estimated from the two
trackers and two gyroscopes alone. The published columns are those of the reference implementation
with its own settings.

```
{learn}
{estimate}
```

{head}
{rows}

On the recording from which it was learned, 19 to 29 s: {tuned_line}; and before the contact,
`fast_contact` 0 to 10 s: {free_line}.

The prior models a rod under loads. The robot hangs from its base, and its weight straightens it. In
free space curvature increases along the second segment; where the robot pushes against something,
curvature decreases from the base. The mechanics of a rod explain both; a prior on strain does not.
The ratio of weight to stiffness is learned (`mass`). The tendons' moments at the ends of segments,
the forces of contacts and the torsional stiffness keep their initial values: in free space the
tendons load the robot only little, so learned values would be too small, and the estimate
overconfident in contact.

The robot rests for nineteen of the 45 s, of which only the last second counts. A robot at rest
repeats the same truth, so it counts once for weight and drifts, and as half a second for mounts.
Counting every sample would give an overconfident robot file. While any part of the robot moves, all
bodies count, because errors at the base change as well. The correlation time of the drifts is
learned with their size. The tip accelerates at {slow:.1f} m/s² (RMS) where weights were learned,
and at {fast:.1f}, {impact:.1f} and {last:.1f} m/s² in the three windows; inertia is left out.
"""


HEAD = """\
| window (s) | position RMSE (mm) | published | rotation RMSE (°) | published | inside 50 % | \
inside 95 % | NEES |
|---|---|---|---|---|---|---|---|"""


def estimated(robot, folder, window, truth=None):
    """Estimate a window from those sensors of the page that the recording has."""
    recording = load_recording(folder)
    use = [name for name in SENSORS if name in recording.streams]
    say(f"{recording.name}, {'all of it' if window is None else '{:g} to {:g} s'.format(*window)}")
    return run_estimate(recording, robot, window=window, use=use or None, truth=truth)


def judged(robot, folder, window):
    """Position and rotation RMSE, coverage and NEES over all sites in a window."""
    found = estimated(robot, folder, window)
    if not found.errors:
        raise GlissandoError(f"{folder} has no truth to judge by: mark its streams as truth.")
    errors = pool(found.errors).summary()
    whole = next(c for c in check(found.errors) if c.site == "all" and c.quantity == "position")
    return {
        "recording": found.recording.name,
        "window": found.window,
        "converged": found.posterior.solve.converged,
        "position": 1e3 * errors["position_rmse"],
        "rotation": np.degrees(errors["rotation_rmse"]),
        "half": 100.0 * whole.coverage(0.5),
        "most": 100.0 * whole.coverage(0.95),
        "nees": whole.mean,
    }


def line(found, position="–", rotation="–"):
    """Line of the table, with the errors of the reference implementation."""
    return (
        "| {:g}–{:g} | ".format(*found["window"]) + f"{found['position']:.2f} | {position} | "
        f"{found['rotation']:.2f} | {rotation} | {found['half']:.0f} % | {found['most']:.0f} % | "
        f"{found['nees']:.2f} |{'' if found['converged'] else ' not converged'}"
    )


def acceleration(robot, name, window, data):
    """Root mean square of the tip's estimated acceleration, m/s²."""
    posterior = estimated(robot, data / name, window, truth=[]).posterior
    time = posterior.grid.time
    tip = posterior.at(np.full(time.size, robot.length), time)
    velocity = np.einsum("kij,kj->ki", tip.pose[:, :3, :3], tip.velocity[:, :3])
    return float(np.sqrt(np.mean(np.sum(np.gradient(velocity, time, axis=0) ** 2, axis=1))))


def judged_windows(robot, data):
    """Results in the reported windows."""
    return [judged(robot, data / name, window) for name, window, *_ in REPORTED_ON]


def page(data, robot):
    """Section of the page: commands and tables."""
    found = zip(judged_windows(robot, data), REPORTED_ON, strict=True)
    rows = [line(each, *published[2:]) for each, published in found]
    tuned = judged(robot, data / TUNED_ON[0], (19.0, 29.0))
    free = judged(robot, data / "fast_contact", (0.0, 10.0))
    moves = [acceleration(robot, *where[:2], data) for where in (TUNED_ON, *REPORTED_ON)]
    return TEXT.format(
        tuned=TUNED_ON[0],
        learn=LEARN.format(
            tuned=f"spacetime/{TUNED_ON[0]}", begin="benchmarks/real.toml", out="learned.toml"
        ),
        estimate=ESTIMATE.format(data="spacetime"),
        head=HEAD,
        rows="\n".join(rows),
        tuned_line=(
            f"{tuned['position']:.2f} mm, {tuned['rotation']:.2f}°, {tuned['most']:.0f} % inside "
            f"95 % (published 9.3 mm, 5.7°)"
        ),
        free_line=(
            f"{free['position']:.2f} mm, {free['most']:.0f} % inside 95 %, NEES {free['nees']:.2f}"
        ),
        slow=moves[0],
        fast=moves[1],
        impact=moves[2],
        last=moves[3],
    )


def learn(data, out):
    """Learn the robot file with the page's command."""
    begin = Path(__file__).with_name("real.toml")
    where = {"tuned": data / TUNED_ON[0], "begin": begin, "out": out}
    words = LEARN.format(**{name: shlex.quote(str(path)) for name, path in where.items()})
    done = subprocess.run([sys.executable, "-m", *shlex.split(words)], stdout=sys.stderr)
    if done.returncode:
        raise GlissandoError(f"nothing was learned into {out}; see above.")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    public = "of the public recordings"
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help=public)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--learned", type=Path, default=Path("learned.toml"), metavar="FILE",
                       help="robot file that is judged (default: learned.toml)")  # fmt: skip
    which.add_argument("--learn", type=Path, metavar="FILE", help="learn it first, into this one")
    alone = "judge on this recording alone"
    parser.add_argument("--recording", type=Path, metavar="FOLDER", help=alone)
    window = "seconds to estimate (default: all)"
    parser.add_argument("--window", nargs=2, type=float, metavar=("T0", "T1"), help=window)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.window and not options.recording:
        parser.error("--window is of a recording; name it with --recording")
    if not options.data.is_dir() and (options.learn or not options.recording):
        raise GlissandoError(f"{options.data} does not hold the public recordings; give --data.")
    if options.learn:
        learn(options.data, options.learn)
    robot = load_robot(options.learn or options.learned)
    if not (options.json or options.recording):
        print(page(options.data, robot))
        return
    window = tuple(options.window) if options.window else None
    alone = options.recording and [judged(robot, options.recording, window)]
    found = alone or judged_windows(robot, options.data)
    if options.json:
        print(json.dumps({"robot": robot.name, "rows": found}))
    else:
        print("\n".join([HEAD, *map(line, found)]))


if __name__ == "__main__":
    run(main)
