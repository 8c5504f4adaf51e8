"""The real robot: learned on one recording, judged on another, with the two commands of the page.

`python benchmarks/real.py --learn FILE` runs the first command and judges the file it writes;
`--robot FILE` judges a file there is, by default the one that learning starts from, real.toml.
"""

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np

from glissando import load_robot
from glissando.consistency import check
from glissando.dataset import load_recording
from glissando.metrics import pool
from glissando.report import run_estimate

DATA = Path("../shared/data/spacetime")
START = Path(__file__).with_name("real.toml")
TRUTH = [f"vicon{i}" for i in range(5)]
SENSORS = ["aurora0", "aurora1", "gyro_mid", "gyro_ee"]
TUNED_ON = ("slow_free_space", (19.0, 45.0))
REPORTED_ON = (
    ("fast_contact", (10.0, 20.0), 8.5, 4.1),
    ("fast_contact", (20.0, 30.0), 11.3, 5.6),
)  # window, and position (mm) and rotation (deg) of the reference implementation
LEARN = (
    "glissando learn {data}/slow_free_space --window 19 45 --robot benchmarks/real.toml "
    "--truth vicon0,vicon1,vicon2,vicon3,vicon4 --joint "
    "--only 'bending,spread linear' --steps 3 --out learned.toml"
)
ESTIMATE = (
    "glissando estimate {data}/fast_contact --window 10 20 --robot learned.toml "
    "--use aurora0,aurora1,gyro_mid,gyro_ee --out results"
)
TEXT = """\
Learned on `{tuned}`, {first:g} to {last:g} s, with all motion capture as truth; its frame, the mounts
of its bodies and that of the coil at the tip are found there too, then fixed. Judged on `fast_contact` from the two
trackers and two gyroscopes alone. Published: the reference implementation with its own settings.

```
{learn}
{estimate}
```

| window (s) | position RMSE (mm) | published | rotation RMSE (°) | published | inside 50 % | inside 95 % | NEES |
|---|---|---|---|---|---|---|---|
{rows}

The same robot file on the recording it was learned on, 19 to 29 s: {tuned_line}; and before
anything touches the robot, `fast_contact` 0 to 10 s: {free_line}.
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


def page(data=DATA, robot=START):
    """The section of the page: commands and table."""
    robot = load_robot(robot)
    rows = []
    for name, window, position, rotation in REPORTED_ON:
        found = judged(robot, name, window, data)
        rows.append(
            f"| {window[0]:g}–{window[1]:g} | {found['position']:.2f} | {position} | "
            f"{found['rotation']:.2f} | {rotation} | {found['half']:.0f} % | {found['most']:.0f} % | "
            f"{found['nees']:.2f} |"
        )
    tuned = judged(robot, TUNED_ON[0], (19.0, 29.0), data)
    line = (
        f"{tuned['position']:.2f} mm, {tuned['rotation']:.2f}°, {tuned['most']:.0f} % inside 95 % "
        f"(published 9.3 mm, 5.7°)"
    )
    free = judged(robot, "fast_contact", (0.0, 10.0), data)
    free_line = (
        f"{free['position']:.2f} mm, {free['most']:.0f} % inside 95 %, NEES {free['nees']:.2f}"
    )
    return TEXT.format(
        tuned=TUNED_ON[0],
        first=TUNED_ON[1][0],
        last=TUNED_ON[1][1],
        learn=LEARN.format(data="spacetime"),
        estimate=ESTIMATE.format(data="spacetime"),
        rows="\n".join(rows),
        tuned_line=line,
        free_line=free_line,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--learn", type=Path, metavar="FILE", help="learn again, into this file")
    parser.add_argument("--robot", default=START, help="robot file to judge")
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"{options.data} does not hold the public recordings.")
    robot = options.robot
    if options.learn:
        options.learn.parent.mkdir(parents=True, exist_ok=True)
        words = LEARN.format(data=options.data).replace("learned.toml", str(options.learn))
        words = shlex.split(words)
        subprocess.run([sys.executable, "-m", *words], check=True)
        robot = options.learn
    print(page(options.data, robot))


if __name__ == "__main__":
    main()
