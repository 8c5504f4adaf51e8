"""What an estimate's position errors are: place, direction, delay, registration, model.

The error of a window is taken apart at every motion-capture body, in the body's own axes. Then
parts are taken away that the estimate cannot be blamed for, each alone: the delay of the truth, one
rigid transform of all truth (its frame), and the constant of each body (its mount). All three are
fitted to the errors, so what they take away is an upper bound; nothing of it is applied elsewhere.
With --vary the window is estimated again with numbers of the separable prior changed one by one.
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
from glissando.io.recording import load_recording
from glissando.io.robot_file import parse_robot, read_robot_document
from glissando.io.shipped_robots import robot_file
from glissando.model.table import Table

BENDING, AXIAL = (3, 4), (2,)
VARIED = {  # what is scaled: key, rows of segments or joints, entries, factor
    "as it is": (),
    "bending of the last segment × 2": (("psd_strain_arclength", slice(-1, None), BENDING, 2.0),),
    "bending of the last segment × 3": (("psd_strain_arclength", slice(-1, None), BENDING, 3.0),),
    "bending of every segment × 3": (("psd_strain_arclength", slice(None), BENDING, 3.0),),
    "bending at joints × 9": (("var_jumps", slice(None), BENDING, 9.0),),
    "bending at the base ÷ 6": (("var_strain", slice(None), BENDING, 1 / 6),),
    "axial strain ÷ 3": (
        ("var_strain", slice(None), AXIAL, 1 / 3),
        ("var_jumps", slice(None), AXIAL, 1 / 3),
    ),
    "axial strain × 4": (
        ("var_strain", slice(None), AXIAL, 4.0),
        ("var_jumps", slice(None), AXIAL, 4.0),
    ),
}
DELAYS = np.linspace(-0.04, 0.04, 17)  # s: of the truth's stamps


def errors(run, delay=0.0):
    """True less estimated positions (M, 3), m, of each body, with the estimated poses (M, 4, 4)."""
    found = []
    for truth in run.truth:
        truth = truth.changed(time=truth.time - delay).inside(run.posterior.grid)
        pose = run.posterior.at(truth.arclength, truth.time).pose @ truth.mount
        found.append((truth.values[:, :3, 3] - pose[:, :3, 3], pose))
    return found


def rmse(each):
    """Root mean square length (mm) of errors (M, 3) of all bodies."""
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.concatenate(each) ** 2, axis=1))))


def registered(found):
    """Errors of each body less the rigid motion of the world that fits all of them best."""
    place = np.concatenate([pose[:, :3, 3] for _, pose in found])
    slope = np.concatenate([np.tile(np.eye(3), (len(place), 1, 1)), -se3.hat3(place)], axis=2)
    error = np.concatenate([e for e, _ in found])
    fit = np.linalg.lstsq(slope.reshape(-1, 6), error.ravel(), rcond=None)[0]
    left = error - slope @ fit
    return np.split(left, np.cumsum([len(e) for e, _ in found])[:-1])


def parts(run):
    """Both tables as dictionaries."""
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
    """The robot of a file with some of its prior's variances scaled."""
    document = expanded(read_robot_document(robot_file(file)))
    for key, rows, entries, factor in changes:
        table = document["base" if key == "var_strain" else "prior"]
        vectors = table[key] if isinstance(table[key][0], list) else [table[key]]
        for vector in vectors[rows]:
            for i in entries:
                vector[i] *= factor
    return parse_robot(Table(document, "varied", GlissandoError))


def variations(file, recording, window, use):
    """Yield a dictionary a change of the prior."""
    for what, changes in VARIED.items():
        robot = varied(file, changes)
        run = run_estimate(recording, robot, window=window, use=use, truth=None)
        told = pool(run.errors).summary()
        yield {
            "prior": what,
            "rmse": 1e3 * told["position_rmse"],
            "inside": told["coverage95_position"],
            "nees": told["nees_position"],
            "log_evidence": run.posterior.solve.log_evidence,
            "converged": run.posterior.solve.converged,
        }


def show_variations(rows, as_json):
    """Print a row a change, or all as JSON."""
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
