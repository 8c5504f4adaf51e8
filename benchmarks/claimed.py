"""Coverage: the share of truth inside 95 % regions, by robot file and recording.

Every shipped robot file is evaluated on the public windows of its robot, and so is the file that
`glissando robot new` writes from length, segments, diameter, bend and sensors alone. There is no
public recording of the sliding robot: its file is evaluated on simulated sessions, and a new file
on shapes of SoroSim. Brackets hold 95 % intervals from resampling blocks of 2 s (at least
five), sessions or shapes.
Usage: claimed.py [FOLDER of public recordings] [--recording FOLDER [--window T0 T1]]
[--robot FILE|NAME] [--json]
"""

import argparse
import json
import math
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import chi2

import shapes
from glissando import GlissandoError, load_robot
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import run_estimate
from glissando.experiments.scenes import Scene, trial
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import read_robot_document
from glissando.io.robot_template import RobotOutline, robot_text
from script import run, say
from sorosim import FILE

DATA = Path("../shared/data/spacetime")
WINDOWS = (
    ("slow_free_space", (19.0, 29.0)),
    ("slow_free_space", (29.0, 45.0)),
    ("fast_contact", (10.0, 20.0)),
    ("fast_contact", (20.0, 30.0)),
    ("fast_contact", (30.0, 34.0)),
    ("extensible", (0.0, 1.0)),
)
SHIPPED = {
    "tdcr466": ("slow_free_space", "fast_contact"),
    "tdcr466-segments": ("slow_free_space", "fast_contact"),
    "extensible1m": ("extensible",),
}
POSES = [f"pose:aurora{i}" for i in range(4)]
TENDONS = RobotOutline(
    "new", 0.466, 2, 0.012, math.pi, [*POSES[:2], "gyro:gyro_mid", "gyro:gyro_ee"]
)
CHOSEN_ON = {("tdcr466-segments", "slow_free_space")}  # used to choose the file; others are tests
# Outlines that a user states for the robot of each recording. That of `extensible` has a tracker at
# the end of each third, and begins compressed to 0.16 of its 1 m: segments that shorten by 85 %.
SQUEEZED = partial(RobotOutline, "new", 1.0, diameter=0.02, sensors=POSES)
NEW = {
    "slow_free_space": {"robot new": TENDONS},
    "fast_contact": {"robot new": TENDONS},
    "extensible": {
        "robot new, 1 segment, stretch 5 %": SQUEEZED(segments=1, bend=math.pi),
        "robot new, 3 segments, stretch 5 %": SQUEEZED(segments=3, bend=0.5 * math.pi),
        "robot new, 3 segments, stretch 85 %": SQUEEZED(
            segments=3, bend=0.5 * math.pi, stretch=0.85
        ),
    },
}
STEEL = RobotOutline("new", 0.6, 2, 1.6e-3, math.pi, ["coil"], stretch=1e-3)  # of SoroSim
BOUNDS = {"shipped": (0.88, 0.99), "new": (0.85, 0.995)}
SCENES = [Scene(shape, slide, 16.44) for shape in "CS" for slide in ("hold", "oscillate")]
SEEDS = range(12)
SHAPES = range(250, 350)
BLOCK = 2.0  # s
LEVEL = 0.95


def described(inside, group, error):
    """Share inside, its 95 % interval from resampling groups, and the RMSE (mm)."""
    groups, at = np.unique(group, return_inverse=True)
    count, hits = np.bincount(at), np.bincount(at, inside)
    drawn = np.random.default_rng(0).integers(groups.size, size=(2000, groups.size))
    shares = hits[drawn].sum(axis=1) / count[drawn].sum(axis=1)
    return {
        "samples": int(inside.size),
        "seen": float(inside.mean()),
        "interval": np.quantile(shares, [0.025, 0.975]).tolist(),
        "rmse_mm": 1e3 * float(np.sqrt(np.mean(error**2))),
    }


def of_recording(robot, folder, window):
    """Coverage in a window of a recording, over all its truth streams."""
    recording = load_recording(folder)
    run = run_estimate(recording, robot, window=window, use=None, truth=None)
    errors = pool(run.errors)
    block = min(BLOCK, np.ptp(errors.time) / 5.0)
    found = described(
        errors.nees_position <= chi2.ppf(LEVEL, 3), errors.time // block, errors.position
    )
    solve = run.posterior.solve
    return found | {"converged": solve.converged, "doubted": bool(solve.doubt)}


def of_sessions():
    """Coverage over simulated sessions of the sliding robot, resampled by session."""
    found = [(trial(scene, seed), group) for group, seed in enumerate(SEEDS) for scene in SCENES]
    errors = [pool(each.errors) for each, _ in found]
    group = np.concatenate(
        [np.full(e.time.size, g) for e, (_, g) in zip(errors, found, strict=True)]
    )
    nees = np.concatenate([e.nees_position for e in errors])
    error = np.concatenate([e.position for e in errors])
    converged = all(each.posterior.solve.converged for each, _ in found)
    return described(nees <= chi2.ppf(LEVEL, 3), group, error) | {"converged": converged}


def of_shapes(document):
    """Coverage over shapes of SoroSim where the coil did not stop, resampled by shape."""
    document["base"]["quaternion"] = [0.5, 0.5, 0.5, 0.5]
    document["sensors"]["coil"]["std"] = shapes.NOISE.tolist()
    judged = shapes.judge(document, shapes.read_shapes(shapes.load_shapes(FILE), SHAPES))
    group = np.repeat(np.arange(len(judged.nees)), judged.nees.shape[1])
    inside = (judged.nees <= chi2.ppf(LEVEL, 3)).ravel()
    return described(inside, group, judged.error.ravel()) | {"converged": True}


def new_file(outline, folder):
    """Write the robot file that `glissando robot new` writes for an outline."""
    file = Path(folder) / "new.toml"
    file.write_text(robot_text(outline), encoding="utf-8")
    return file


def rows(folder):
    """Yield a dictionary for each robot file and recording."""
    with tempfile.TemporaryDirectory() as written:
        public = [(name, window) for name, window in WINDOWS if (folder / name).is_dir()]
        for name, window in public:
            where = {"recording": name, "window": window}
            for robot in (r for r, names in SHIPPED.items() if name in names):
                found = of_recording(load_robot(robot), folder / name, window)
                yield {"robot": robot, "kind": "shipped", **where, **found}
            for label, outline in NEW[name].items():
                robot = load_robot(new_file(outline, written))
                found = of_recording(robot, folder / name, window)
                yield {"robot": label, "kind": "new", **where, **found}
        simulated = {"recording": "simulated C and S", "window": None}
        yield {"robot": "sliding700", "kind": "shipped", **simulated, **of_sessions()}
        if FILE.is_file():
            document = read_robot_document(new_file(STEEL, written))
            where = {"recording": "SoroSim", "window": None}
            yield {"robot": "robot new", "kind": "new", **where, **of_shapes(document)}


HEAD = """\
| robot file | recording | samples | claimed | observed, 95 % interval | RMSE (mm) | within |
|---|---|---|---|---|---|---|"""


def line(row):
    """Row of the table."""
    span = " {:g}–{:g} s".format(*row["window"]) if row["window"] else ""
    span += ", chosen on it" if (row["robot"], row["recording"]) in CHOSEN_ON else ""
    low, high = BOUNDS[row["kind"]]
    verdict = "yes" if low <= row["seen"] <= high else "no"
    interval = "{:.0f}–{:.0f}".format(*(100 * v for v in row["interval"]))
    return (
        f"| {row['robot']} | {row['recording']}{span} | {row['samples']} | {100 * LEVEL:g} % | "
        f"{100 * row['seen']:.1f} % ({interval}) | {row['rmse_mm']:.2f} | {verdict}"
        f"{'' if row['converged'] else ', not converged'}"
        f"{', with a warning' if row.get('doubted') else ''} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    parser.add_argument("--recording", type=Path, help="this recording alone, with --robot")
    parser.add_argument("--robot", metavar="FILE|NAME", help="default: the recording's own")
    parser.add_argument("--window", nargs=2, type=float, metavar=("T0", "T1"))
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.recording:
        recording = load_recording(options.recording)
        robot = load_robot(options.robot) if options.robot else recording.robot
        if robot is None:
            raise GlissandoError(f"{recording.name} names no robot; give --robot.")
        window = tuple(options.window) if options.window else None
        where = {"robot": robot.name, "kind": "shipped", "recording": recording.name}
        every = [{**where, "window": window, **of_recording(robot, options.recording, window)}]
    elif options.window or options.robot:
        parser.error("--window and --robot are of a recording; name it with --recording")
    elif not options.folder.is_dir():
        raise GlissandoError(f"{options.folder} is not a folder of recordings; give --recording.")
    else:
        every = rows(options.folder)
    found = []
    if not options.json:
        print(HEAD)
    for row in every:
        say(f"{row['robot']}, {row['recording']}")
        found.append(row)
        if not options.json:
            print(line(row), flush=True)
    if options.json:
        print(json.dumps({"level": LEVEL, "rows": found}))


if __name__ == "__main__":
    run(main)
