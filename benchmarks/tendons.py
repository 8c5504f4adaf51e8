"""Learn a robot of three segments and nine tendons, and predict the tip in other recordings.

The files are those of `data/sysid` of github.com/ContinuumRoboticsLab/opencr-mujoco: displacements
of servos and the position of a marker beyond the tip. The robot is that of benchmarks/tendon_robots
with the servos named in the files.

    python benchmarks/tendons.py --train v4_train.csv v4_single_pulls.csv --judge other.csv --json

Only the commands of the file in `--judge` are used. Structure and priors were chosen by leaving out
whole patterns (pair12, pair13, pair23, all pairs) of the two public training files, never by errors
on rows learned from; `--leave-out WORD` repeats such a test with the rows of the training files
whose pattern contains the word.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from glissando.calibration.robot.learn_tendons import TendonData, learn_tendons
from glissando.errors import GlissandoError
from glissando.estimation.tendon_prediction import predict_tip
from glissando.geometry.se3 import Array
from glissando.io.foreign.servo_csv import read_servo_csv
from glissando.io.robot_file import load_robot
from glissando.model.robot import Robot
from glissando.model.tendons.replicate import TIP
from script import run

ROBOTS = Path(__file__).parent / "tendon_robots"


@dataclass(frozen=True)
class _Rows:
    """Rows of several files in the order of time, without duplicate times."""

    names: tuple[str, ...]
    displacement: Array
    tip: Array
    pattern: np.ndarray

    def take(self, rows: np.ndarray) -> _Rows:
        return _Rows(self.names, self.displacement[rows], self.tip[rows], self.pattern[rows])


def _read(files: list[Path]) -> _Rows:
    logs = [read_servo_csv(file) for file in files]
    for log, file in zip(logs, files, strict=True):
        if log.names != logs[0].names:
            raise GlissandoError(
                f"{file.name} is of servos {', '.join(log.names)}, {files[0].name} of "
                f"{', '.join(logs[0].names)}; give files of one robot."
            )
    times = np.concatenate([log.time for log in logs])
    once = np.unique(times, return_index=True)[1]
    displacement = np.concatenate([log.displacement for log in logs])[once]
    tip = np.concatenate([log.tip for log in logs])[once]
    pattern = np.array([name for log in logs for name in log.pattern])[once]
    return _Rows(logs[0].names, displacement, tip, pattern)


def _robot_of(names: tuple[str, ...]) -> Robot:
    robots = [load_robot(path) for path in sorted(ROBOTS.glob("*.toml"))]
    for robot in robots:
        if robot.tendons is not None and robot.tendons.names == names:
            return robot
    known = "; ".join(f"{r.name}: {', '.join(r.tendons.names)}" for r in robots if r.tendons)
    raise GlissandoError(
        f"No robot in {ROBOTS} has servos {', '.join(names)}; known are {known}. Add its file, or "
        f"name one with --robot."
    )


def _judged(robot: Robot, rows: _Rows) -> dict[str, float]:
    """Errors of the predicted tips, and the share inside their 95 % ellipsoids."""
    position, cov = predict_tip(robot, rows.displacement, TIP)
    error = rows.tip - position
    size = np.linalg.norm(error, axis=1)
    square = np.einsum("mi,mij,mj->m", error, np.linalg.inv(cov), error)
    return {
        "rows": len(size),
        "rmse_mm": 1e3 * float(np.sqrt(np.mean(size**2))),
        "median_mm": 1e3 * float(np.median(size)),
        "worst_mm": 1e3 * float(size.max()),
        "inside_95": float(np.mean(square <= chi2.ppf(0.95, 3))),
        "nees": float(np.mean(square) / 3.0),
        "mean_std_mm": 1e3 * float(np.mean(np.sqrt(np.einsum("mii->m", cov)))),
    }


def _blocks(pattern: np.ndarray) -> np.ndarray:
    """Block numbers of six blocks of whole patterns, assigned in the order of recording.

    For a single pattern, blocks are time intervals.
    """
    names = [name.removesuffix("_hold") for name in pattern]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    if len(number) < 2:
        return np.arange(len(names)) * 6 // max(len(names), 1)
    return np.array([number[name] % 6 for name in names])


def main() -> int:
    """Learn, predict, and print the errors of the tip."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    add = parser.add_argument
    add("--train", type=Path, nargs="+", required=True, metavar="FILE")
    add("--judge", type=Path, nargs="+", metavar="FILE", help="(default: the rows left out)")
    add("--robot", type=Path, metavar="FILE", help="robot to start from (default: by servos)")
    add("--leave-out", default="", metavar="WORD", help="rows of --train not to learn from")
    add("--json", action="store_true", help="print one JSON object and nothing else")
    options = parser.parse_args()
    rows = _read(options.train)
    robot = load_robot(options.robot) if options.robot else _robot_of(rows.names)
    left_out = np.array(
        [bool(options.leave_out) and options.leave_out in name for name in rows.pattern]
    )
    judged = _read(options.judge) if options.judge else rows.take(left_out)
    if judged.names != rows.names or not len(judged.tip):
        raise GlissandoError("Nothing to judge: give --judge a file of the same robot.")
    began, used = time.process_time(), rows.take(~left_out)
    data = TendonData.of(used.displacement, used.tip, _blocks(used.pattern))
    learned = learn_tendons(robot, data, lambda text: print(text, file=sys.stderr, flush=True))
    result = {
        "robot": robot.name,
        "learned_from": len(used.tip),
        "rmse_learned_from_mm": 1e3 * learned.rmse,
        "rmse_left_out_mm": 1e3 * learned.held_out_rmse,
        **_judged(learned.robot, judged),
        "cpu_s": time.process_time() - began,
    }
    if options.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:24s}{value if isinstance(value, (str, int)) else f'{value:.4g}'}")
    return 0


if __name__ == "__main__":
    run(main)
