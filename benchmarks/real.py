"""The real robot: learned on one recording, judged on another, with the two commands of the page.

`python benchmarks/real.py --learn FILE` learns the robot file first, which takes a minute or two;
`--learned FILE` judges one that is there.
"""

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np

from glissando import load_robot
from glissando.evaluation.consistency import check
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import run_estimate
from glissando.io.recording_folder import load_recording

DATA = Path("../shared/data/spacetime")
TRUTH = [f"vicon{i}" for i in range(5)]
SENSORS = ["aurora0", "aurora1", "gyro_mid", "gyro_ee"]
TUNED_ON = ("slow_free_space", (19.0, 45.0))
REPORTED_ON = (
    ("fast_contact", (10.0, 20.0), 8.5, 4.1),
    ("fast_contact", (20.0, 30.0), 11.3, 5.6),
    ("fast_contact", (30.0, 34.0), "–", "–"),
)  # window, and position (mm) and rotation (deg) of the reference implementation
LEARN = (
    "glissando learn {data}/slow_free_space --window 0 45 --robot benchmarks/real.toml "
    "--truth vicon0,vicon1,vicon2,vicon3,vicon4 --joint "
    "--only 'mass,spread linear,correlation' --out {out}"
)
ESTIMATE = (
    "glissando estimate {data}/fast_contact --window 10 20 --robot learned.toml "
    "--use aurora0,aurora1,gyro_mid,gyro_ee --out results"
)
TEXT = """\
The robot file was learned on `{tuned}` with all motion capture as truth. The frame of motion
capture, the mounts of its bodies and that of the coil at the tip were estimated there too, then
fixed. The table judges it on `fast_contact`, estimated from the two trackers and two gyroscopes
alone. The published columns are those of the reference implementation with its own settings.

```
{learn}
{estimate}
```

| window (s) | position RMSE (mm) | published | rotation RMSE (°) | published | inside 50 % | inside 95 % | NEES |
|---|---|---|---|---|---|---|---|
{rows}

On the recording it was learned on, 19 to 29 s: {tuned_line}; and before the contact,
`fast_contact` 0 to 10 s: {free_line}.

The prior is that of a rod under loads. The robot hangs from its base, and its weight straightens it:
in free space curvature grows along the second segment, and where the robot pushes against something
curvature falls from the base. A prior on strain knows neither, and both are one rod. What the robot
weighs for its stiffness is learned (`mass`). The tendons' moments at the ends of segments, the forces
of contacts and the torsional stiffness keep their initial values: tendons alone pull the robot little
there, so that learned values are small, and in contact the estimate is then overconfident.

The robot rests for nineteen of the 45 s, of which the last counts. A resting robot repeats the same truth, which counts
once for weight and drifts and for half a second for mounts; counting every sample makes an overconfident
robot file. While any of it moves, all of it counts: errors at the base change then, too. How long drifts
last is learned with their size. The tip accelerates at {slow:.1f} m/s² (RMS) where weights were learned,
and at {fast:.1f}, {impact:.1f} and {last:.1f} m/s² in the three windows; inertia is left out.
"""


def judged(robot, name, window, data=DATA):
    """One run on a window: position and rotation RMSE, coverage, NEES of all sites together."""
    recording = load_recording(data / name)
    run = run_estimate(recording, robot, window=window, use=SENSORS, truth=TRUTH)
    errors = pool(run.errors).summary()
    whole = next(c for c in check(run.errors) if c.site == "all" and c.quantity == "position")
    return {
        "converged": run.posterior.solve.converged,
        "position": 1e3 * errors["position_rmse"],
        "rotation": np.degrees(errors["rotation_rmse"]),
        "half": 100.0 * whole.coverage(0.5),
        "most": 100.0 * whole.coverage(0.95),
        "nees": whole.mean,
        "seconds": run.posterior.solve.seconds["total"],
    }


def row(robot, name, window, position, rotation, data):
    """A line of the table."""
    found = judged(robot, name, window, data)
    return (
        f"| {window[0]:g}–{window[1]:g} | {found['position']:.2f} | {position} | "
        f"{found['rotation']:.2f} | {rotation} | {found['half']:.0f} % | {found['most']:.0f} % | "
        f"{found['nees']:.2f} |"
    )


def acceleration(robot, name, window, data):
    """Root mean square of the tip's acceleration as estimated, m/s²."""
    run = run_estimate(load_recording(data / name), robot, window=window, use=SENSORS, truth=[])
    time = run.posterior.grid.time
    tip = run.posterior.at(np.full(time.size, robot.length), time)
    velocity = np.einsum("kij,kj->ki", tip.pose[:, :3, :3], tip.velocity[:, :3])
    return float(np.sqrt(np.mean(np.sum(np.gradient(velocity, time, axis=0) ** 2, axis=1))))


def page(data, file):
    """The section of the page: commands and tables."""
    robot = load_robot(file)
    rows = [row(robot, *each, data) for each in REPORTED_ON]
    tuned = judged(robot, TUNED_ON[0], (19.0, 29.0), data)
    free = judged(robot, "fast_contact", (0.0, 10.0), data)
    moves = [acceleration(robot, *where[:2], data) for where in (TUNED_ON, *REPORTED_ON)]
    return TEXT.format(
        tuned=TUNED_ON[0],
        learn=LEARN.format(data="spacetime", out="learned.toml"),
        estimate=ESTIMATE.format(data="spacetime"),
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


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--learned", type=Path, default=Path("learned.toml"), metavar="FILE")
    parser.add_argument("--learn", type=Path, metavar="FILE", help="learn again, into this one")
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"{options.data} does not hold the public recordings.")
    if options.learn:
        begin = Path(__file__).with_name("real.toml")
        words = LEARN.format(data=options.data, out=options.learn)
        words = words.replace("benchmarks/real.toml", shlex.quote(str(begin)))
        subprocess.run([sys.executable, "-m", *shlex.split(words)], check=True, stdout=sys.stderr)
    print(page(options.data, options.learn or options.learned))


if __name__ == "__main__":
    main()
