"""Speed-up of a study by a second worker, and the overhead of Dask per cell.

Wall-clock seconds of the same cells with one and two workers in turn, after a few cells that load
the library, and of a plain loop. Other load on the machine affects the result, so rounds are
repeated; with two cores the best ratio is two. Usage: study.py [--cells N] [--rounds N]
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

from glissando.experiments.runner import cluster, outcome
from glissando.experiments.study.plan import Study
from glissando.experiments.study.store import Store, run_cells


def loop(cells):
    began = time.perf_counter()
    for cell in cells:
        outcome(cell.scene, cell.seed)
    return time.perf_counter() - began


def spread(study, workers):
    with cluster(None, workers) as client, tempfile.TemporaryDirectory() as folder:
        warm, cells = study.cells()[: 2 * workers], study.cells()[2 * workers :]
        run_cells(client, warm, Store(study, Path(folder) / "warm", resume=False))
        began = time.perf_counter()
        run_cells(client, cells, Store(study, Path(folder) / "cells", resume=False))
        return (time.perf_counter() - began) / len(cells)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    fixed = {"shape": "C", "duration": 4.0, "set": 0.0}
    study = Study("speed", {"noise": [1.0, 2.0]}, fixed, range(options.cells // 2), Path())
    outcome(study.cells()[0].scene, 0)
    found = {"a loop": [], "1 worker": [], "2 workers": []}
    for _ in range(options.rounds):
        found["a loop"].append(loop(study.cells()) / len(study))
        for workers, name in ((1, "1 worker"), (2, "2 workers")):
            found[name].append(spread(study, workers))
    middle = {name: float(np.median(seconds)) for name, seconds in found.items()}
    print("| a cell (ms) | loop | 1 worker | 2 workers | 1 worker / 2 workers |")
    print("|---|---|---|---|---|")
    numbers = " | ".join(f"{1e3 * seconds:.1f}" for seconds in middle.values())
    ratio = middle["1 worker"] / middle["2 workers"]
    print(f"| median of {options.rounds} | {numbers} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
