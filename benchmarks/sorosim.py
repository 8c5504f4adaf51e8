"""Simulated static shapes against 500 of another group's Cosserat solver, SoroSim.

Its strain is a few modes in each of two segments; ours is spectral. Usage: sorosim.py [FILE.csv]
"""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.simulation import Loads, Rod, Wrench, solve_shape

FILE = Path("../shared/data/sorosim/spring_steel_statics.csv")


def differences(file):
    """Distances (500, 14) in metres and angles (500, 14) in radians at the stations of the file."""
    with file.open() as text:
        table = [[float(x) for x in row[1:]] for row in list(csv.reader(text))[2:]]
    cases = np.array(table).reshape(500, 6, 17)  # [Euler angles, position] by [3 loads, 14 places]
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # their tangent is body x, ours z
    base = np.eye(4)
    base[:3, :3] = axes
    rod = Rod.of_tubes(0.6, [(1.6e-3, 0.0)], young=200e9, poisson=0.33, density=7870.0, base=base)
    fractions = 0.3 * np.array([0, 0.0469, 0.2308, 0.5, 0.7692, 0.9531, 1])
    s = np.concatenate([fractions, 0.3 + fractions])
    distance, angle = np.empty((2, 500, s.size))
    for i, (euler, place) in enumerate(cases.reshape(500, 2, 3, 17)):
        wrenches = [Wrench(end, place[:, k], euler[:, k]) for end, k in ((0.3, 1), (0.6, 2))]
        pose = solve_shape(rod, [], Loads(gravity=place[:, 0], wrenches=wrenches)).at(s).pose
        distance[i] = np.linalg.norm(pose[:, :3, 3] - place[:, 3:].T, axis=-1)
        theirs = Rotation.from_euler("XYZ", euler[:, 3:].T).as_matrix() @ axes
        angle[i] = Rotation.from_matrix(np.swapaxes(theirs, 1, 2) @ pose[:, :3, :3]).magnitude()
    return distance, angle


def line(file):
    """Row of a table: distances at the tip (mm), median to largest, and the largest angle."""
    distance, angle = differences(file)
    tip = 1e3 * distance[:, -1]
    return (
        f"| {np.median(tip):.2f} | {np.quantile(tip, 0.99):.2f} | {tip.max():.2f} | "
        f"{np.degrees(angle.max()):.2f} |"
    )


if __name__ == "__main__":
    print("| median (mm) | 99 % (mm) | largest (mm) | largest angle (°) |")
    print(line(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE))
