"""Simulated motion of rods against tip releases by another group's Cosserat solver, SoroSim.

A file's first line has the material's damping (a Kelvin–Voigt retardation time, s: damping is
stiffness times retardation) and, in its last three columns, gravity; its second line has moment and
force that hold the middle and the tip until time 0; then each line has a time and the poses of
middle and tip as Euler angles X-Y-Z and position. Their tangent is body x, and the base is clamped
along world x. Nothing is fitted to a file.

Usage: releases.py --young 200e9 --poisson 0.33 --density 7870 --radius 8e-4 --length 0.6 FILE…
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from glissando.errors import GlissandoError, NoShapeError
from glissando.simulation import Rod, Wrench
from glissando.simulation.dynamics import DynamicMotion, Scenario, TimedWrench, simulate_motion
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod_equations import AppliedLoads, RodEquations
from glissando.simulation.rod_mechanics import natural_frequencies

_HEAD = (
    "| file | damping (s) | travel (mm) | middle (%) | tip (%) | Hz | the file's | modes (Hz) "
    "| closed form | × real time |"
)
AXES = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # their tangent is body x, ours z
TIMOSHENKO = np.array([1.8751040687, 4.6940911330])  # cos x cosh x = −1


class Release(NamedTuple):
    """Content of a file: damping (s), gravity, times (K,), positions of middle and tip (2, K, 3).

    `turn` (2, K, 3) are their Euler angles X-Y-Z, rad; `holding` (2, 6) are moment and force that
    hold middle and tip until time 0.
    """

    damping: float
    gravity: np.ndarray
    holding: np.ndarray
    time: np.ndarray
    place: np.ndarray
    turn: np.ndarray


def read_release(path: Path) -> Release:
    """Read the release of a file; raises GlissandoError if the file has another form."""
    try:
        lines = [line.replace(",", " ").split() for line in path.read_text().splitlines()]
        table = np.array([[float(x) for x in line] for line in lines if line])
    except (OSError, ValueError) as problem:
        raise GlissandoError(f"{path} cannot be read as numbers, 13 a line: {problem}.") from None
    if table.ndim != 2 or table.shape[1] != 13 or len(table) < 4:
        raise GlissandoError(f"{path} has a table {table.shape}; a release has 13 columns.")
    motion = table[2:]
    turn, place = np.moveaxis(motion[:, 1:].reshape(-1, 2, 2, 3), (2, 1), (0, 1))
    holding = table[1, 1:].reshape(2, 6)
    return Release(table[0, 0], table[0, 10:13], holding, motion[:, 0], place, turn)


def simulate(release: Release, rod: Rod, duration: float) -> DynamicMotion:
    """Simulate the rod after its release."""
    held = [
        TimedWrench(Wrench(s, wrench[3:], wrench[:3]), stop=0.0)
        for s, wrench in zip((0.5 * rod.length, rod.length), release.holding, strict=True)
    ]
    scenario = Scenario(gravity=release.gravity, wrenches=tuple(held))
    return simulate_motion(rod, [], scenario, duration)


def rod_of(release: Release, options: argparse.Namespace) -> Rod:
    """Rod with the material of the options and a file's damping."""
    base = np.eye(4)
    base[:3, :3] = AXES
    return Rod.of_tubes(
        options.length,
        [(2.0 * options.radius, 0.0)],
        young=options.young,
        poisson=options.poisson,
        density=options.density,
        base=base,
        retardation=release.damping,
    )


def main_frequency(motion: np.ndarray, rate: float) -> float:
    """Frequency (Hz) of the strongest oscillation of a decaying motion (K, 3).

    The peak of the spectrum in the principal direction, with a Hann window and eightfold zero
    padding, is refined by a parabola.
    """
    x = motion - motion.mean(axis=0)
    x = x @ np.linalg.svd(x, full_matrices=False)[2][0]
    size = np.log(np.abs(np.fft.rfft(x * np.hanning(x.size), 8 * x.size)) + 1e-300)
    k = int(np.clip(np.argmax(size[8:]) + 8, 1, size.size - 2))
    low, top, high = size[k - 1 : k + 2]
    return float((k + 0.5 * (low - high) / (low - 2.0 * top + high)) * rate / (8 * x.size))


def modes(rod: Rod) -> np.ndarray:
    """Frequencies (2,) of the clamped rod's first two bending modes, Hz, on two elements."""
    equations = RodEquations.of(rod, [], Mesh.through([0.0, rod.length], 0.5 * rod.length))
    instant = AppliedLoads(rod.base, np.zeros(3), np.zeros((0, 4)))
    at = equations.at(np.stack([equations.rest, *np.zeros((2, *equations.rest.shape))]), instant)
    return natural_frequencies(equations, at, instant)[[0, 2]]  # frequencies come in pairs, x and y


def judge(path: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Compare a file with the simulation: differences over travel, frequencies, and time taken."""
    release = read_release(path)
    rod = rod_of(release, options)
    first = release.time <= options.seconds + 1e-9
    times = release.time[first]
    begin = time.process_time()
    motion = simulate(release, rod, float(times[-1]))
    motion.at(rod.length, np.arange(0.0, times[-1], 1e-3))
    took = time.process_time() - begin
    theirs = release.place[:, first]
    ours = motion.at(np.array([[0.5], [1.0]]) * rod.length, times).pose[..., :3, 3]
    travel = float(np.linalg.norm(theirs[1][:, None] - theirs[1][None], axis=2).max())
    rmse = np.sqrt(np.mean(np.sum((ours - theirs) ** 2, axis=-1), axis=1))
    stiffness = rod.stiffness[3] / rod.mass_per_length
    beam = (TIMOSHENKO / rod.length) ** 2 * np.sqrt(stiffness) / (2.0 * np.pi)
    rate = 1.0 / float(np.median(np.diff(times)))
    energy = motion.energies
    return {
        "file": path.name,
        "damping": release.damping,
        "travel": travel,
        "rmse_mid": float(rmse[0]),
        "rmse_tip": float(rmse[1]),
        "share_mid": float(rmse[0] / travel),
        "share_tip": float(rmse[1] / travel),
        "frequency": main_frequency(ours[1], rate),
        "frequency_file": main_frequency(theirs[1], rate),
        "modes": modes(rod).tolist(),
        "modes_closed_form": beam.tolist(),
        "energy_imbalance": float(np.abs(energy.imbalance).max() / np.ptp(energy.total)),
        "steps": int(motion.time.size),
        "cpu_seconds": took,
        "real_time_factor": float(times[-1] / took),
    }


def draw(path: Path, options: argparse.Namespace) -> None:
    """Draw the simulated and the file's tip of a release over time, and their difference."""
    import matplotlib.pyplot as plt

    release = read_release(path)
    times = release.time[release.time <= options.seconds + 1e-9]
    motion = simulate(release, rod_of(release, options), float(times[-1]))
    ours, theirs = motion.at(options.length, times).pose[:, :3, 3], release.place[1, : times.size]
    figure, (top, low) = plt.subplots(2, 1, sharex=True, figsize=(7, 4.5), height_ratios=[2, 1])
    for k, (name, colour) in enumerate(zip("xyz", ("C0", "C1", "C2"), strict=True)):
        top.plot(times, 1e3 * theirs[:, k], color=colour, lw=4, alpha=0.3)
        top.plot(times, 1e3 * ours[:, k], color=colour, lw=1, label=name)
    low.plot(times, 1e3 * np.linalg.norm(ours - theirs, axis=1), color="k", lw=1)
    top.set_ylabel("tip (mm)")
    top.set_title("Ours (thin) and SoroSim's (broad)")
    top.legend(loc="right")
    low.set_ylabel("distance (mm)")
    low.set_xlabel("time (s)")
    figure.tight_layout()
    figure.savefig(options.figure, dpi=110)


def main() -> int:
    """Print a row per file, or all results as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add = parser.add_argument
    for name, unit in (("young", "Pa"), ("poisson", ""), ("density", "kg/m³")):
        add(f"--{name}", type=float, required=True, help=unit)
    add("--radius", type=float, required=True, help="m")
    add("--length", type=float, required=True, help="m")
    add("--seconds", type=float, default=1.0, help="how much of each file (default 1)")
    add("--figure", type=Path, metavar="PNG", help="draw the tip of the first file")
    add("--json", action="store_true", help="print JSON instead of a table")
    add("files", type=Path, nargs="+", metavar="FILE")
    options = parser.parse_args()
    rows = []
    if not options.json:
        print(_HEAD + "\n" + "|---" * _HEAD.count(" | ") + "|---|")
    for path in options.files:
        try:
            row = judge(path, options)
        except (GlissandoError, NoShapeError) as problem:
            print(f"{path}: {problem}")
            return 2
        rows.append(row)
        if not options.json:
            modes_of = (
                ", ".join(f"{f:.2f}" for f in row[k]) for k in ("modes", "modes_closed_form")
            )
            print(
                f"| {row['file']} | {row['damping']:g} | {1e3 * row['travel']:.0f} | "
                f"{100 * row['share_mid']:.2f} | {100 * row['share_tip']:.2f} | "
                f"{row['frequency']:.2f} | {row['frequency_file']:.2f} | {' | '.join(modes_of)} | "
                f"{row['real_time_factor']:.1f} |",
                flush=True,
            )
    if options.figure:
        draw(options.files[0], options)
    if options.json:
        print(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
