"""Errors of calibrations, and their stated standard deviations, over simulated sessions.

`python benchmarks/calibration.py` prints the table of docs/calibration.md, from seeds that were not
used for any choice; `--development` uses the seeds by which motion, noise and method were chosen;
`--motions` prints the standard deviations that motions of one session leave, by Fisher information.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

import rigs_drawn as rigs
from glissando import load_robot
from glissando.calibration.rig.calibrate import calibrate
from glissando.calibration.rig.rig import PARAMETERS

SHOWN = {  # by parameter: label, factor to the unit, largest error allowed
    "tracker delay": ("tracker's delay, ms", 1e3, 2.0),
    "slide delay": ("slide's delay, ms", 1e3, 2.0),
    "zero": ("slide's zero, mm", 1e3, 0.3),
    "backlash": ("play, mm", 1e3, np.inf),
    "lead": ("lead, %", 1e2, np.inf),
}


MOTIONS = (  # bends, slide, s
    ("waving", "even", 15.0),
    ("waving", "two speeds", 15.0),
    ("posed", "calibrate", 15.0),
    ("posed", "calibrate", 30.0),
    ("posed", "calibrate", 45.0),
    ("posed", "calibrate", 60.0),
)


def motions() -> None:
    """Print the standard deviations of one rig's constants, play included, after each motion."""
    shown = [SHOWN[name] for name in SHOWN]
    print("| bends | slide | s | " + " | ".join(label for label, _, _ in shown) + " |")
    print("|---|---|---|" + "---|" * len(shown))
    trials = [(f"{motion[0]} | {motion[1]}", motion, rigs.robot()) for motion in MOTIONS]
    shipped = load_robot("sliding700")
    trials.append(("the same, with the shipped robot's prior | ", MOTIONS[4], shipped))
    for what, (bends, slide, lasts), robot in trials:
        rigs.LONGER = lasts
        rigs.motion.cache_clear()
        data, _ = rigs.drawn(0, bends, sliding=slide)
        std = calibrate(data, robot).std
        each = [f"{SHOWN[name][1] * std[PARAMETERS.index(name)]:.2g}" for name in SHOWN]
        print(f"| {what} | {lasts:g} | " + " | ".join(each) + " |", flush=True)


def main() -> int:
    """Print the table; the exit status is 1 if an error or the NEES is out of bounds."""
    if "--motions" in sys.argv:
        motions()
        return 0
    seeds = rigs.DEVELOPMENT if "--development" in sys.argv else rigs.REPORT
    trials = []
    for seed in seeds:
        trials.append(rigs.trial(seed))
        print(f"seed {seed}: NEES {trials[-1].nees:.1f}", file=sys.stderr, flush=True)
    errors, std = (np.array([getattr(t, name) for t in trials]) for name in ("off", "std"))
    count, size = errors.shape
    print(f"{count} sessions, seeds {seeds[0]} to {seeds[-1]}, {rigs.LONGER:g} s each\n")
    heads = "RMS error | largest error | stated std | mean square error over stated variance"
    print(f"| | {heads} |\n|---|---|---|---|---|")
    good = True
    for name, (label, unit, most) in SHOWN.items():
        k = PARAMETERS.index(name)
        each, stated = unit * errors[:, k], unit * np.sqrt(np.mean(std[:, k] ** 2))
        ratio = np.mean((errors[:, k] / std[:, k]) ** 2)
        rms, largest = np.sqrt(np.mean(each**2)), np.abs(each).max()
        good &= bool(largest < most)
        print(f"| {label} | {rms:.2g} | {largest:.2g} | {stated:.2g} | {ratio:.2f} |")
    nees = np.mean([t.nees for t in trials]) / size
    print(f"\nNEES by dimension {nees:.2f}; of such means", end="")
    for share in (0.998, 0.95):
        tails = 0.5 - 0.5 * share, 0.5 + 0.5 * share
        low, high = chi2.ppf(tails, count * size) / (count * size)
        print(
            f" {100 * share:g} % lie in {low:.2f} to {high:.2f}",
            end=", " if share > 0.99 else ".\n",
        )
    return 0 if good and low < nees < high else 1


if __name__ == "__main__":
    sys.exit(main())
