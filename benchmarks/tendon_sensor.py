"""Error of the whole body from a sliding coil, alone and with the displacements of nine tendons.

Simulated robots like sliding700, with three tendons ending at each third of it, in a C and in an S.

    python benchmarks/tendon_sensor.py --seeds 0,1,2 --json
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from pathlib import Path

import numpy as np

from glissando.evaluation.metrics import pool
from glissando.evaluation.run import run_estimate
from glissando.io.recording_folder import load_recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file
from glissando.simulation.simulate import simulate
from glissando.simulation.simulated_session import write_session

TENSIONS = {"C": "[0, 0, 0, 0, 0, 0, 8, 0, 0]", "S": "[10, 0, 0, 0, 0, 0, 0, 6, 0]"}
WINDOW, DURATION = (2.0, 7.0), 8.0


def robot_text() -> str:
    """Text of the robot file: sliding700 with nine tendons and twice the nodes."""
    text = robot_file("sliding700").read_text()
    tendons = ""
    for k, end in enumerate((0.233, 0.467, 0.7)):
        for angle in np.deg2rad(40.0 * k + 120.0 * np.arange(3)):
            x, y = 5e-3 * np.cos(angle), 5e-3 * np.sin(angle)
            tendons += f"[[physics.tendons]]\noffset = [{x:.6f}, {y:.6f}]\nend = {end}\n"
            tendons += "friction = 0.15\n"
    first, after = text.index("[[physics.tendons]]"), text.index("[physics.slide]")
    text = text[:first] + tendons + text[after : text.index("[physics.shapes.straight]")]
    for name, row in TENSIONS.items():
        text += f"[physics.shapes.{name}]\ntensions = {row}\n"
    return re.sub(r"arclength_nodes = 8\b", "arclength_nodes = 16", text)


def measured(seeds: list[int], folder: Path) -> dict[str, dict[str, float]]:
    """RMSE over the body (mm), share inside 95 % and NEES, by shape and sensors used."""
    file = folder / "nine.toml"
    file.write_text(robot_text())
    robot, result = load_robot(file), {}
    for shape in TENSIONS:
        errors: dict[str, list[dict[str, float]]] = {"coil": [], "coil,tendons": []}
        for seed in seeds:
            session = simulate(file, shape=shape, seed=seed, tendons=True, duration=DURATION)
            write_session(session, folder / f"{shape}{seed}", file)
            recording = load_recording(folder / f"{shape}{seed}")
            for use, found in errors.items():
                run = run_estimate(recording, robot, window=WINDOW, use=use.split(","), truth=None)
                found.append(pool(run.errors).summary())
        for use, found in errors.items():
            squares = np.mean([e["position_rmse"] ** 2 for e in found])
            result[f"{shape} {use}"] = {
                "rmse_mm": 1e3 * float(np.sqrt(squares)),
                "inside_95": float(np.mean([e["coverage95_position"] for e in found])),
                "nees": float(np.mean([e["nees_position"] for e in found])),
            }
    return result


def main() -> None:
    """Simulate, estimate and print the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", default="0,1,2", metavar="N,…")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        result = measured([int(seed) for seed in options.seeds.split(",")], Path(name))
    if options.json:
        print(json.dumps(result))
        return
    for name, row in result.items():
        print(f"{name:16s}" + "".join(f"{key} {value:8.3f}   " for key, value in row.items()))


if __name__ == "__main__":
    main()
