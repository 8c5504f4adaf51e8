"""Draw the shapes of a robot under pull of each tendon in turn, with 95 % ellipses.

python benchmarks/tendons_figure.py --robot benchmarks/tendon_robots/v4.toml --out docs/tendons.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from glissando.estimation.tendon_prediction import predict
from glissando.io.robot_file import load_robot


def main() -> None:
    """Predict the shapes, draw and save the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robot", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    robot = load_robot(options.robot)
    assert robot.tendons is not None
    count = len(robot.tendons)
    figure, axes = plt.subplots(1, 3, figsize=(9.0, 3.4), sharey=True, layout="constrained")
    pulls = np.array([0.0, 1.5e-3, 3e-3, 4.5e-3])
    for plot, first in zip(axes, (0, 3, 6), strict=True):
        displacement = np.full((pulls.size, count), -5e-3)
        displacement[:, first] = pulls
        found = predict(robot, np.arange(pulls.size, dtype=float), displacement)
        toward = found.position[-1, -1, :2] / np.linalg.norm(found.position[-1, -1, :2])
        plane = np.array([[*toward, 0.0], [0.0, 0.0, 1.0]])
        seen = 1e3 * found.position @ plane.T
        cov = 1e6 * plane @ found.cov_position_world @ plane.T
        circle = np.linspace(0.0, 2.0 * np.pi, 60)
        ring = np.sqrt(chi2.ppf(0.95, 2)) * np.stack([np.cos(circle), np.sin(circle)])
        for k, pulled in enumerate(pulls):
            (line,) = plot.plot(*seen[k].T, label=f"{1e3 * pulled:g} mm")
            size, turn = np.linalg.eigh(cov[k, -1])
            plot.fill(*(seen[k, -1, :, None] + (turn * np.sqrt(np.maximum(size, 0.0))) @ ring),
                      color=line.get_color(), alpha=0.3)  # fmt: skip
        plot.set(xlabel="mm", title=f"{robot.tendons.names[first]} pulled", aspect="equal")
    axes[0].set_ylabel("mm")
    axes[0].legend(frameon=False, fontsize="small")
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
