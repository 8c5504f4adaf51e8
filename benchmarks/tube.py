"""Distribution-free guarantees: a whole-body tube on SoroSim, and sets for the next reading.

Shapes: a conformal tube calibrated on shapes 1 to 250, and the share of shapes 251 to 500 wholly
inside (all stations where the coil did not stop). The prior was learned on half of the first 250.
Recordings: each is replayed unchanged, with 5 % gross outliers, and with streams that jump half
way; the miss rate of adaptive sets must be within the bound.
Usage: tube.py [FOLDER of public recordings] [--recording FOLDER] [--robot NAME] [--window T0 T1]
[--json]   (some minutes)
"""

import argparse
import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import shapes
from glissando import GlissandoError, load_robot
from glissando.evaluation.conformal import conformal_tube, inside_tube
from glissando.evaluation.plausibility.finding import CHECKS
from glissando.evaluation.replay import replay
from glissando.io.recording_folder import load_recording
from script import run, say
from sorosim import FILE

DATA = Path("../shared/data/spacetime")
CALIBRATED_ON = range(250)
REPORTED_ON = shapes.REPORTED_ON  # shapes 251 to 500
RECORDINGS = (("slow_free_space", (19.0, 29.0)), ("fast_contact", (10.0, 20.0)))
ROBOT = "tdcr466-segments"
OUTLIERS = 0.05
SEED = 5


def shape_scores(numbers, poses, document=shapes.LEARNED):
    """Largest normalised error (B,) of each shape over its stations where the coil did not stop."""
    judged = shapes.judge(document, shapes.read_shapes(poses, numbers))
    return np.sqrt(judged.nees.max(axis=1))


def tube_of_shapes(file=FILE):
    """Width of the tube, and the share of test shapes inside it, at two levels."""
    poses = shapes.load_shapes(file)
    tuned, judged = (shape_scores(n, poses) for n in (CALIBRATED_ON, REPORTED_ON))
    out = []
    for level in (0.9, 0.95):
        tube = conformal_tube(tuned, 0.0, level)
        out.append({"level": level, "sigmas": tube.sigmas, "inside": inside_tube(tube, judged)})
    return out


def corrupted(recording, how, window, rng):
    """Recording with gross outliers, or with streams that jump half way through a window."""
    streams, half = {}, float(np.mean(window or recording.span()))
    for name, stream in recording.streams.items():
        rows, values = stream.rows, np.array(stream.rows.values)
        random = rng.random(rows.time.size)
        hit = random < OUTLIERS if how == "outliers" else rows.time > half
        if values.ndim == 3:
            values[hit, :3, 3] += 0.1
        else:
            values[hit] += 3.0
        streams[name] = replace(stream, rows=replace(rows, values=values))
    return replace(recording, streams=streams)


def adaptive_sets(folder, robot, window):
    """Yield a dictionary per stream and kind of corruption."""
    recording, rng = load_recording(folder), np.random.default_rng(SEED)
    for how in ("as it is", "outliers", "breaks off"):
        say(f"{recording.name}, {how}")
        spoiled = recording if how == "as it is" else corrupted(recording, how, window, rng)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spoilt = () if spoiled is recording else tuple(CHECKS)  # else refused
            run = replay(spoiled, robot, window=window, truth=[], allow=spoilt)
        for name, sets in run.adaptive.items():
            off = abs(sets.miss_rate - (1.0 - sets.level))
            yield {
                "recording": recording.name, "window": window, "how": how, "stream": name,
                "count": sets.count, "miss_rate": sets.miss_rate, "bound": sets.bound,
                "within": off <= sets.bound,
            }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA, help="of the recordings")
    parser.add_argument("--recording", type=Path, help="this recording alone, no shapes")
    parser.add_argument("--robot", default=ROBOT, help=f"robot file or name (default: {ROBOT})")
    window = "seconds of --recording (default: all)"
    parser.add_argument("--window", nargs=2, type=float, metavar=("T0", "T1"), help=window)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    if options.window and not options.recording:
        parser.error("--window is of a recording; name it with --recording")
    chosen = [(options.folder / name, window) for name, window in RECORDINGS]
    if options.recording:
        chosen = [(options.recording, tuple(options.window) if options.window else None)]
    chosen = [each for each in chosen if options.recording or each[0].is_dir()]
    if not chosen:
        raise GlissandoError(f"{options.folder} holds no public recordings; give --recording.")
    robot = load_robot(options.robot)
    found = {"shapes": tube_of_shapes() if FILE.is_file() and not options.recording else []}
    found["next_reading"] = [
        each for folder, window in chosen for each in adaptive_sets(folder, robot, window)
    ]
    print(json.dumps(found) if options.json else page(found))


def page(found):
    """Both tables as text."""
    lines = [
        *("| level | σ | shapes 251 to 500 wholly inside |", "|---|---|---|"),
        *(
            f"| {100 * s['level']:g} % | {s['sigmas']:.2f} | {100 * s['inside']:.1f} % |"
            for s in found["shapes"]
        ),
        *("", "| recording | data | stream | readings | missed | bound | within |"),
        "|---|---|---|---|---|---|---|",
        *(
            f"| {s['recording']} | {s['how']} | {s['stream']} | {s['count']} | "
            f"{100 * s['miss_rate']:.1f} % | 5 ± {100 * s['bound']:.1f} % | "
            f"{'yes' if s['within'] else 'no'} |"
            for s in found["next_reading"]
        ),
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    run(main)
