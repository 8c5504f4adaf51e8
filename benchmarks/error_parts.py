"""Decomposition of position errors by body, direction, delay, registration and model.

The errors of a window are given for each motion-capture body, in the body's axes. Then parts that
are errors of the truth, not of the estimate, are removed, each alone: the delay of the truth, one
rigid transform of all truth (its frame), and a constant of each body (its mount). All three are
fitted to the errors, so the reduction is an upper bound; the fits are not used elsewhere.
With --vary the window is estimated again with numbers of a mechanical prior changed one by one.
Usage: error_parts.py --robot FILE|NAME --recording FOLDER [--window T0 T1] [--use NAME …] [--vary]
[--json]
"""

import argparse
import json
from pathlib import Path

import numpy as np

from glissando import load_robot
from glissando.calibration.robot.hyperparameters import expanded
from glissando.errors import GlissandoError
from glissando.evaluation.metrics import pool
from glissando.evaluation.run import run_estimate
from glissando.geometry import se3
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import parse_robot, read_robot_document
from glissando.io.shipped_robots import robot_file
from glissando.model.table import Table

MASSES = ("mechanics", "mass_per_length"), ("mechanics", "tip", "mass")
MOMENTS = (("prior", "var_points", 0), slice(3, None)), (("prior", "var_tip"), slice(3, None))
VARIED = {  # scaled numbers: keys of the number or vector, its entries, factor
    "as it is": (),
    "no weight": [(key, None, 1e-6) for key in MASSES],
    "weight ÷ 2": [(key, None, 0.5) for key in MASSES],
    "weight × 2": [(key, None, 2.0) for key in MASSES],
    "weight upwards": [(("mechanics", "gravity"), slice(None), -1.0)],
    "moments of tendons × 2": [(*each, 4.0) for each in MOMENTS],
    "moments of tendons ÷ 2": [(*each, 0.25) for each in MOMENTS],
    "loads × 2": [(("prior", "psd_load"), slice(0, 3), 4.0)],
    "loads ÷ 2": [(("prior", "psd_load"), slice(0, 3), 0.25)],
    "force at the tip × 2": [(("prior", "var_tip"), slice(0, 3), 4.0)],
    "bending set × 2": [(("prior", "psd_strain_error"), slice(3, 5), 4.0)],
    "axial set × 2": [(("prior", "psd_strain_error"), slice(2, 3), 4.0)],
    "torsional stiffness ÷ 3": [(("mechanics", "stiffness"), slice(5, None), 1 / 3)],
    "time scale × 2": [(("prior", "time_scale"), None, 2.0)],
}
DELAYS = np.linspace(-0.04, 0.04, 17)  # s: of the truth's stamps


def errors(run, delay=0.0):
    """True minus estimated positions (M, 3), m, and estimated poses (M, 4, 4), of each body."""
    found = []
    for truth in run.truth:
        truth = truth.changed(time=truth.time - delay).inside(run.posterior.grid)
        pose = run.posterior.at(truth.arclength, truth.time).pose @ truth.mount
        found.append((truth.values[:, :3, 3] - pose[:, :3, 3], pose))
    return found


def rmse(each):
    """Root mean square norm (mm) of errors (M, 3) of all bodies."""
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.concatenate(each) ** 2, axis=1))))


def registered(found):
    """Errors of each body after subtracting the best rigid transform of all bodies."""
    place = np.concatenate([pose[:, :3, 3] for _, pose in found])
    slope = np.concatenate([np.tile(np.eye(3), (len(place), 1, 1)), -se3.hat3(place)], axis=2)
    error = np.concatenate([e for e, _ in found])
    fit = np.linalg.lstsq(slope.reshape(-1, 6), error.ravel(), rcond=None)[0]
    residual = error - slope @ fit
    return np.split(residual, np.cumsum([len(e) for e, _ in found])[:-1])


def parts(run):
    """Errors by body, and RMSE (mm) without each part."""
    found = errors(run)
    bodies = []
    for truth, (error, pose) in zip(run.truth, found, strict=True):
        along = 1e3 * np.einsum("mji,mj->mi", pose[:, :3, :3], error)
        bodies.append(
            {
                "body": truth.label,
                "arclength": float(np.mean(truth.arclength)),
                "rmse": rmse([error]),
                "mean": along.mean(axis=0).tolist(),
                "spread": along.std(axis=0).tolist(),
            }
        )
    late = [rmse([e for e, _ in errors(run, delay)]) for delay in DELAYS]
    without = {
        "nothing": rmse([e for e, _ in found]),
        f"a delay of {1e3 * DELAYS[np.argmin(late)]:.0f} ms": min(late),
        "a rigid transform of all truth": rmse(registered(found)),
        "a constant of each body": rmse([e - e.mean(axis=0) for e, _ in found]),
    }
    return bodies, without


def varied(file, changes):
    """Robot of a file with some numbers of its mechanical prior scaled."""
    document = expanded(read_robot_document(robot_file(file)))
    for (*way, last), entries, factor in changes:
        table = document
        for key in way:
            table = table[key]
        table[last] = scaled(table[last], entries, factor)
    return parse_robot(Table(document, "varied", GlissandoError))


def scaled(value, entries, factor):
    """Number, or entries of a vector or of all rows of a table, times a factor."""
    if entries is None:
        return value * factor
    out = np.array(value, dtype=float)
    out[..., entries] *= factor
    return out.tolist()


def variations(file, recording, window, use):
    """Yield a dictionary for each change of the prior."""
    for what, changes in VARIED.items():
        robot = varied(file, changes)
        run = run_estimate(recording, robot, window=window, use=use, truth=None)
        summary = pool(run.errors).summary()
        yield {
            "prior": what,
            "rmse": 1e3 * summary["position_rmse"],
            "inside": summary["coverage95_position"],
            "nees": summary["nees_position"],
            "log_evidence": run.posterior.log_evidence,
            "converged": run.posterior.solve.converged,
        }


def show_variations(rows, as_json):
    """Print a row per change, or all as JSON."""
    if as_json:
        print(json.dumps({"variations": list(rows)}))
        return
    print("| prior | RMSE (mm) | inside 95 % | NEES | log evidence |\n|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['prior']} | {row['rmse']:.2f} | {100 * row['inside']:.0f} % | "
            f"{row['nees']:.2f} | {row['log_evidence']:.0f}"
            f"{'' if row['converged'] else ', not converged'} |",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recording", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--robot", required=True, metavar="FILE|NAME")
    parser.add_argument("--window", nargs=2, type=float, metavar=("T0", "T1"))
    parser.add_argument("--use", nargs="+", metavar="NAME", help="default: all that is no truth")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--vary", action="store_true", help="change the prior's numbers instead")
    options = parser.parse_args()
    recording, window = load_recording(options.recording), options.window
    window = tuple(window) if window else None
    if options.vary:
        show_variations(variations(options.robot, recording, window, options.use), options.json)
        return
    robot = load_robot(options.robot)
    run = run_estimate(recording, robot, window=window, use=options.use, truth=None)
    bodies, without = parts(run)
    if options.json:
        print(json.dumps({"bodies": bodies, "rmse_without": without}))
        return
    print("| body | arclength (m) | RMSE (mm) | mean x, y, z (mm) | spread x, y, z (mm) |")
    print("|---|---|---|---|---|")
    for body in bodies:
        mean, spread = (", ".join(f"{v:+.1f}" for v in body[k]) for k in ("mean", "spread"))
        print(
            f"| {body['body']} | {body['arclength']:.3f} | {body['rmse']:.2f} | {mean} | {spread} |"
        )
    print("\n| without | RMSE (mm) |\n|---|---|")
    for what, value in without.items():
        print(f"| {what} | {value:.2f} |")


if __name__ == "__main__":
    main()
