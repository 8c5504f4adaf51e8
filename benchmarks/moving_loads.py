"""Force along a rod that moves under unknown loads: bias at mode and mean, and false contacts.

The truth is a nitinol rod of 0.5 m and 1.2 mm without weight under a wrench that follows its tip,
drawn from the prior and integrated from the tip to the base. Force and moment are those of a rod
that buckles at 60 mN. Usage: moving_loads.py [--sessions N] [--seed SEED] [--json]
"""

import argparse
import json
import sys
import warnings

import numpy as np

from glissando import CoilReadings, FixedLagSmoother, Grid, SolverOptions, estimate
from glissando.errors import EstimateWarning
from glissando.estimation.batch import estimate_in_passing
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from plan_page import table
from script import run, say

warnings.simplefilter("ignore", EstimateWarning)  # the columns show what they say

LENGTH, PIECES, DURATION = 0.5, 240, 2.5
STIFFNESS = np.array([2e4, 2e4, 7e4, 6.1e-3, 6.1e-3, 4.6e-3])
PER_NEWTON = np.repeat([1.0, 0.03], 3)  # N and N m of the tip's wrench
NODES = np.linspace(0.0, LENGTH, 7)
NOISE = np.repeat([0.7e-3, 7e-3], [3, 2])
FORCES = [
    {"std": 0.01, "rate": 20},
    {"std": 0.02, "rate": 10},
    {"std": 0.02, "rate": 20},
    {"std": 0.02, "rate": 40},
    {"std": 0.02, "rate": 20, "still": True},
    {"std": 0.02, "rate": 20, "times": 1.7},
]
CONTACTS = [
    {"std": std, "scale": scale, "sliding": sliding}
    for std, scale in ((0.01, 1.0), (0.02, 1.0), (0.01, 0.3))
    for sliding in (False, True)
]


def prior(std, scale=1.0):
    """The prior of that rod, whose tip's force has this standard deviation (N) and time scale."""
    return MechanicalPrior(
        Mechanics(STIFFNESS[None], np.array([1e-6]), gravity=np.zeros(3)),
        psd_load=np.repeat([1e-8, 1e-12], 3),
        psd_strain_error=np.repeat([1e-10, 1e-6], 3),
        var_tip=(std * PER_NEWTON) ** 2,
        time_scale=scale,
        var_base=np.full(6, 1e-10),
    )


def loads(rng, time, std, scale=1.0):
    """Matérn wrenches (K, 6) at the tip, in its own frame."""
    gap = np.sqrt(3.0) * np.abs(time[:, None] - time) / scale
    cov = (1.0 + gap) * np.exp(-gap) + 1e-10 * np.eye(time.size)
    return std * PER_NEWTON * (np.linalg.cholesky(cov) @ rng.standard_normal((time.size, 6)))


def poses(load):
    """Poses (PIECES + 1, K, 4, 4) of the rod under wrenches (K, 6), by the midpoint rule."""
    step, wrench = LENGTH / PIECES, load.copy()
    back = [np.broadcast_to(np.eye(4), (len(load), 4, 4))]

    def slope(w):
        strain = np.array([0, 0, 1.0, 0, 0, 0]) + w / STIFFNESS
        v, u = strain[:, :3], strain[:, 3:]
        moment = np.cross(u, w[:, 3:]) + np.cross(v, w[:, :3])
        return strain, np.hstack([np.cross(u, w[:, :3]), moment])

    for _ in range(PIECES):
        _, change = slope(wrench)
        strain, change = slope(wrench + 0.5 * step * change)
        wrench = wrench + step * change
        back.append(back[-1] @ se3.exp(-step * strain))
    return se3.inverse(back[-1]) @ np.stack(back[::-1])


def coil(rng, time, load, place):
    """Readings of a coil at places (K,) of the rod under wrenches (K, 6)."""
    piece = np.round(place / LENGTH * PIECES).astype(int)
    off = np.zeros((time.size, 6))
    off[:, :5] = NOISE * rng.standard_normal((time.size, 5))
    values = poses(load)[piece, np.arange(time.size)] @ se3.exp(off)
    return CoilReadings(time=time, arclength=piece * (LENGTH / PIECES), values=values, cov=NOISE**2)


def force_row(sessions, seed, std, rate, still=False, times=1.0):
    """Errors of the force along the tip, at the mode and at the mean, over sessions."""
    time, off = np.arange(0.0, DURATION, 1.0 / rate), {"mode": [], "mean": []}
    for k in range(sessions):
        rng = np.random.default_rng([seed, k])
        load = loads(rng, time, times * std)
        load = np.repeat(load[:1], time.size, axis=0) if still else load
        given = prior(std), Grid(NODES, time), [coil(rng, time, load, np.full(time.size, LENGTH))]
        mode = estimate_in_passing(*given, [], SolverOptions())
        for name, posterior in (("mode", mode), ("mean", estimate(*given))):
            tip = posterior.load(LENGTH, time)
            off[name].append([tip.wrench[:, 2] - load[:, 2], tip.std[:, 2]])
        say(f"{k + 1} of {sessions} sessions")
    row = {"std": std, "rate": rate, "still": still, "times": times}
    for name, each in off.items():
        error, stated = np.concatenate(each, axis=1)
        row[name] = {
            "bias": error.mean(), "rmse": np.sqrt(np.mean(error**2)),
            "stated": np.sqrt(np.mean(stated**2)), "nees": np.mean((error / stated) ** 2),
        }  # fmt: skip
    return row


def contact_row(sessions, seed, std, scale, sliding):
    """Share of times at which a loop takes an untouched rod for touched; 1 % is asked for."""
    time, said = np.arange(0.0, 3.0, 0.05), []
    place = LENGTH * (0.55 + 0.45 * np.cos(5.0 * time)) if sliding else np.full(time.size, LENGTH)
    for k in range(sessions):
        rng = np.random.default_rng([seed, k, 1])
        readings = coil(rng, time, loads(rng, time, std, scale), place)
        smoother = FixedLagSmoother(prior(std, scale), NODES, window=4)
        for now in time:
            smoother.add(readings.select(readings.time == now))
            smoother.advance(now)
            said.append(bool(smoother.contacts().detected))
        say(f"{k + 1} of {sessions} sessions")
    return {"std": std, "scale": scale, "sliding": sliding, "touched": float(np.mean(said))}


def page(forces, contacts):
    """Both tables in Markdown."""
    rows = []
    for row in forces:
        a, b = row["mode"], row["mean"]
        name = f"{1e3 * row['std']:.0f} mN" + ", still" * row["still"]
        name += f", {row['times']:g} times as large" if row["times"] != 1.0 else ""
        both = [f"{1e3 * a[of]:.0f} → {1e3 * b[of]:.0f}" for of in ("bias", "rmse", "stated")]
        rows.append([name, row["rate"], *both, f"{a['nees']:.1f} → {b['nees']:.1f}"])
    heads = ["std of the tip's force", "readings a second", "bias (mN)", "RMS error (mN)"]
    text = table([*heads, "stated (mN)", "NEES"], rows)
    rows = [
        [f"{1e3 * row['std']:.0f} mN", f"{row['scale']:g}", "slides" if row["sliding"] else "tip",
         f"{100.0 * row['touched']:.1f} %"]
        for row in contacts
    ]  # fmt: skip
    heads = ["std of the tip's force", "time scale (s)", "coil", "times said to be touched"]
    return "\n".join([*text, "", *table(heads, rows)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=12, help="of each row")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    forces = [force_row(options.sessions, options.seed, **case) for case in FORCES]
    contacts = [contact_row(options.sessions, options.seed, **case) for case in CONTACTS]
    if options.json:
        json.dump({"forces": forces, "contacts": contacts}, sys.stdout)
        print()
    else:
        print(page(forces, contacts))
    return 0


if __name__ == "__main__":
    run(main)
