"""Estimates of the middle of a released rod from its base and a tip coil, under three priors.

The files are tip releases of another group's solver (see releases.py). A five-degree-of-freedom
coil reads the tip at 40 Hz; the base's pose is known, and there are no other readings. Positions of
middle and tip are evaluated at the file's times over the first second. The densities of the
white-noise prior, and the loads of the mechanical prior with inertia (one number), maximise the
evidence of the same readings; the prior without inertia has loads that bend the rod by a third of
its length. Online, the newest state of a smoother of four time nodes is evaluated at each time
node, with loads of 6 % of the rod's weight: rounding in a short window prevents much smaller loads,
which evidence prefers. The files' rounding to 0.1 mm is included in the covariance.

Usage: fast_motion.py --young 200e9 --poisson 0.33 --density 7870 --radius 8e-4 --length 0.6 FILE…
"""

import argparse
import json
import time
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from glissando import CoilReadings, FixedLagSmoother, estimate
from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.model.grid import Grid
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.inertia import Inertia
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from releases import AXES, read_release, rod_of

TIP = 0.4  # standard deviation of the tip force, over that of the load on the whole rod
ONLINE = 0.06  # standard deviation of loads, over the rod's weight
VAR_BASE = 1e-10, 1e-9  # m², rad²: the base is fixed; the second online, for numerical precision
ERROR = 1e-8, 1e-6  # densities of the model error in bending; the second online
ROUNDING = 1e-4**2 / 12.0  # m²: variance of rounding to 0.1 mm
NOISE = np.repeat([0.7e-3, np.radians(0.4)], [3, 2])  # standard deviation per axis, m and rad
RATE, NODE_RATE, NODES = 40.0, 80.0, 9
INERTIAL = ("with inertia", "with inertia, online")
WINDOW = 4  # time nodes of the smoother
CHI2 = 7.8147  # of three components, 95 %


def coil(release, options, seed):
    """Noisy coil readings of the tip."""
    rng = np.random.default_rng(seed)
    wanted = np.arange(0.0, options.seconds + 1e-9, 1.0 / RATE)
    rows = np.unique(np.abs(release.time[:, None] - wanted).argmin(axis=0))
    pose = np.tile(np.eye(4), (rows.size, 1, 1))
    pose[:, :3, :3] = Rotation.from_euler("XYZ", release.turn[1, rows]).as_matrix() @ AXES
    pose[:, :3, 3] = release.place[1, rows]
    error = rng.standard_normal((rows.size, 6)) * np.append(NOISE, NOISE[-1])
    where = {"time": release.time[rows], "arclength": np.full(rows.size, options.length)}
    return CoilReadings(**where, values=pose @ se3.exp(error), cov=NOISE**2, name="coil")


def mechanical(release, rod, load, tip, online=False):
    """Mechanical prior with standard deviations (N) of the total load and of the tip force."""
    force = np.repeat([load**2, (0.01 * load * rod.length) ** 2], 3) / rod.length
    gravity = {"gravity": release.gravity}
    return MechanicalPrior(
        Mechanics(rod.stiffness[None], np.array([rod.mass_per_length]), **gravity),
        psd_load=force,
        psd_strain_error=np.repeat([1e-9, ERROR[online]], 3),
        var_tip=np.repeat([tip**2, (0.01 * tip * rod.length) ** 2], 3),
        time_scale=0.1,
        var_base=np.full(6, VAR_BASE[online]),
        base_pose=rod.base,
    )


def moving(release, rod, options, share, online=False):
    """Mechanical prior with inertia, for loads of a share of the rod's weight."""
    load = share * rod.mass_per_length * rod.length * 9.81
    largest = 3.0 * rod.stiffness[3] / rod.length**2  # N: bends the rod by a third of its length
    prior = mechanical(release, rod, load, TIP * load, online)
    return replace(prior, inertia=Inertia(options.modes, release.damping, 0.0, float(largest)))


def white_noise(release, rod, numbers):
    """White-noise prior with densities exp(numbers) of bending, its change, and velocity."""
    bending, change, speed = np.exp(numbers)
    stiff = np.full(3, 1e-6)
    return WhiteNoisePrior(
        psd_velocity_time=np.repeat([speed, 10.0 * speed], 3),
        psd_strain_arclength=np.concatenate([stiff, np.full(3, bending)]),
        psd_strain_time=np.concatenate([stiff, np.full(3, change)]),
        psd_velocity_arclength=np.concatenate([stiff, np.full(3, change)]),
        base=BaseDensity(np.full(6, 1e-8), np.repeat([1e-6, 1e2], 3), np.full(6, 1e-6)),
        base_pose=rod.base,
    )


def fitted(make, simplex, evaluations, grid, readings):
    """Prior of largest evidence over the parameters (P,) of `make`, by Nelder–Mead."""

    def miss(numbers):
        try:
            return -estimate(make(numbers), grid, readings, gate=None).log_evidence
        except (GlissandoError, np.linalg.LinAlgError):
            return 1e9

    limits = {"maxfev": evaluations, "initial_simplex": simplex}
    found = scipy.optimize.minimize(miss, simplex[0], method="Nelder-Mead", options=limits)
    return make(found.x)


def judged(prior, grid, readings, release, options):
    """RMSE (m), NEES and share inside 95 % of middle and tip, of the batch estimate."""
    begin = time.process_time()
    posterior = estimate(prior, grid, readings, gate=None)
    early = release.time <= options.seconds + 1e-9
    found = posterior.at(np.array([[0.5], [1.0]]) * options.length, release.time[early])
    gap = found.position - release.place[:, early]
    return {
        **errors(gap, found.cov_position_world),
        "iterations": posterior.solve.iterations,
        "converged": posterior.solve.converged,
        "cpu_seconds": time.process_time() - begin,
    }


def judged_online(prior, grid, readings, release, options):
    """RMSE (m), NEES and share inside 95 % of the newest state online, and the restarts.

    Evaluated from the third reading on.
    """
    judged_nodes = [grid.arclength.size // 2, -1]
    wanted = grid.time[grid.time <= options.seconds + 1e-9]
    rows = np.unique(np.abs(release.time[:, None] - wanted).argmin(axis=0))
    smoother = FixedLagSmoother(prior, grid.arclength, window=WINDOW, gate=None)
    (stream,), place, cov, before = readings, [], [], -np.inf
    begin = time.process_time()
    for now in release.time[rows]:
        smoother.add(stream.select((stream.time > before) & (stream.time <= now)))
        at = smoother.advance(float(now))
        place.append(at.position[judged_nodes])
        cov.append(at.cov_position_world[judged_nodes])
        before = now
    gap = np.stack(place, axis=1) - release.place[:, rows]
    known = release.time[rows] >= stream.time[2]  # velocity is not yet observable with two readings
    return {
        **errors(gap[:, known], np.stack(cov, axis=1)[:, known]),
        "restarts": smoother.restarts,
        "cpu_seconds": time.process_time() - begin,
    }


def errors(gap, cov):
    """RMSE (m), NEES and share inside 95 % of middle and tip, from errors (2, K, 3)."""
    cov = cov + ROUNDING * np.eye(3)
    distance = np.linalg.solve(cov, gap[..., None])[..., 0]
    nees = np.sum(gap * distance, axis=-1)
    inside = np.mean(nees < CHI2, axis=1)
    rmse = np.sqrt(np.mean(np.sum(gap**2, axis=-1), axis=1))
    return {
        "rmse_mid": float(rmse[0]),
        "rmse_tip": float(rmse[1]),
        "inside_mid": float(inside[0]),
        "inside_tip": float(inside[1]),
        "nees_mid": float(nees[0].mean() / 3.0),
        "nees_tip": float(nees[1].mean() / 3.0),
        "std_mid": float(np.median(np.sqrt(np.trace(cov[0], axis1=-2, axis2=-1)))),
    }


def judge(path, options, seed):
    """Evaluate each prior on a file, with one draw of the coil's noise."""
    release = read_release(path)
    rod = rod_of(release, options)
    steps = round(options.seconds * options.node_rate)
    grid = Grid(
        np.linspace(0.0, options.length, options.nodes), np.arange(steps + 1) / options.node_rate
    )
    readings = [coil(release, options, seed)]
    on = grid, readings
    inertial = partial(moving, release, rod, options)
    simplex = np.log([[0.01], [0.002]])
    priors = {"with inertia": fitted(lambda x: inertial(np.exp(x[0])), simplex, 8, *on)}
    share = np.sqrt(priors["with inertia"].psd_load[0] * options.length)
    share /= rod.mass_per_length * rod.length * 9.81
    if not options.only:
        force = 3.0 * rod.stiffness[3] / rod.length**2
        priors["mechanical"] = mechanical(release, rod, force, force)
        simplex = np.log([0.1, 1e2, 1e2]) - 2.0 * np.eye(4, 3, -1)
        priors["white noise"] = fitted(partial(white_noise, release, rod), simplex, 30, *on)
    rows = {name: judged(each, *on, release, options) for name, each in priors.items()}
    online = inertial(ONLINE, online=True)
    rows["with inertia, online"] = judged_online(online, *on, release, options)
    return {"file": path.name, "seed": seed, "loads": float(share), **rows}


def summed(found, name):
    """Lines for each file and for all: least and largest error, mean coverage and NEES."""
    files = list(dict.fromkeys(rows["file"] for rows in found))
    for file in [*files, "all"]:
        own = [rows[name] for rows in found if file in (rows["file"], "all")]

        def column(key, own=own):
            return np.array([row[key] for row in own])

        middle, tip = (1e3 * column(f"rmse_{place}") for place in ("mid", "tip"))
        inside = [100.0 * column(f"inside_{place}").mean() for place in ("mid", "tip")]
        nees = [column(f"nees_{place}").mean() for place in ("mid", "tip")]
        print(
            f"| {file} | {len(own)} | {name} | {middle.min():.2f} … {middle.max():.2f} "
            f"| {tip.min():.2f} … {tip.max():.2f} | {inside[0]:.1f} | {inside[1]:.1f} "
            f"| {nees[0]:.2f} | {nees[1]:.2f} | {1e3 * np.median(column('std_mid')):.2f} |"
        )


def main():
    """Print a row per file, draw and prior, or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add = parser.add_argument
    for name, unit in (("young", "Pa"), ("poisson", ""), ("density", "kg/m³")):
        add(f"--{name}", type=float, required=True, help=unit)
    add("--radius", type=float, required=True, help="m")
    add("--length", type=float, required=True, help="m")
    add("--seconds", type=float, default=1.0, help="how much of each file (default 1)")
    add("--seeds", type=int, nargs="+", default=[0], help="of the coil's noise (default 0)")
    add("--modes", type=int, default=4, help="bending modes that move (default 4)")
    add("--nodes", type=int, default=NODES, help="arclength nodes, an odd number (default 9)")
    add("--node-rate", type=float, default=NODE_RATE, help="time nodes a second (default 80)")
    add("--only", action="store_true", help="judge the prior with inertia alone")
    add("--json", action="store_true", help="print JSON instead of a table")
    add("files", type=Path, nargs="+", metavar="FILE")
    options = parser.parse_args()
    found = []
    if not options.json:
        print(
            "| file | seed | loads (%) | prior | middle (mm) | tip | inside 95 % | tip "
            "| NEES | tip | σ (mm) | s |"
        )
        print("|---" * 12 + "|")
    for path, seed in product(options.files, options.seeds):
        try:
            rows = judge(path, options, seed)
        except GlissandoError as problem:
            print(f"{path}: {problem}")
            return 2
        found.append(rows)
        if options.json:
            continue
        for name in ("white noise", "mechanical", *INERTIAL):
            if name in rows:
                row = rows[name]
                print(
                    f"| {path.name} | {seed} | {100 * rows['loads']:.2f} | {name} "
                    f"| {1e3 * row['rmse_mid']:.2f} | {1e3 * row['rmse_tip']:.2f} "
                    f"| {100 * row['inside_mid']:.1f} | {100 * row['inside_tip']:.1f} "
                    f"| {row['nees_mid']:.2f} | {row['nees_tip']:.2f} | {1e3 * row['std_mid']:.2f} "
                    f"| {row['cpu_seconds']:.0f} |",
                    flush=True,
                )
    if options.json:
        print(json.dumps(found, indent=1))
    elif len(options.seeds) > 1:
        print("\n| file | draws | prior | middle (mm) | tip | inside (%) | tip | NEES | tip | σ |")
        print("|---" * 10 + "|")
        for name in INERTIAL:
            summed(found, name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
