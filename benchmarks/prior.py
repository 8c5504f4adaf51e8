"""Choice of the prior of sliding700 by its NEES on shapes that are used for no result.

The density of strain along the body is varied; the table has mean NEES per degree of freedom and
coverage over the still shapes of TUNED_ON, with a fixed, an oscillating and a traversing sensor.
Usage: prior.py [SEEDS]
"""

import os
import sys
from dataclasses import replace

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from rich.console import Console
from rich.table import Table

from glissando.evaluation.metrics import pool
from glissando.experiments import scenes
from glissando.experiments.scenes import TUNED_ON
from glissando.experiments.studies import table_arms

FACTORS = (0.3, 1.0, 3.0)
ARMS = ("fixed", "oscillating", "traverse fast")
FIRST_SEED = 1000


def judged(shape, arm, seed):
    """NEES per dof, coverage and RMSE (m) of one trial for each factor on the strain's density."""
    scene = table_arms(shape)[arm]
    known, rows = scenes.prior(scene), []
    for factor in FACTORS:
        base = replace(known.base, strain=factor * known.base.strain)
        psd = factor * known.psd_strain_arclength
        prior = replace(known, psd_strain_arclength=psd, base=base)
        summary = pool(scenes.trial(scene, seed, prior).errors).summary()
        rows.append([summary[k] for k in ("nees_position", "coverage95_position", "position_rmse")])
    return rows


def main(seeds=3):
    """Print a row per factor: means over shapes and seeds, and RMSE of the fixed sensor."""
    still = [shape for shape, tensions in TUNED_ON.items() if len(tensions) == 1]
    found = np.array(
        [
            [[judged(shape, arm, FIRST_SEED + seed) for seed in range(seeds)] for arm in ARMS]
            for shape in still
        ]
    )  # [shape, arm, seed, factor, number]
    table = Table("density ×", "NEES / dof", "inside 95 %", "fixed sensor's RMSE (cm)")
    for k, factor in enumerate(FACTORS):
        nees, inside = found[..., k, :2].mean(axis=(0, 1, 2))
        fixed = 100 * np.sqrt(np.mean(found[:, 0, :, k, 2] ** 2))
        table.add_row(f"{factor:g}", f"{nees:.2f}", f"{100 * inside:.1f} %", f"{fixed:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:2]))
