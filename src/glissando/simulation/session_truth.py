"""Ground-truth files of a simulated robot with inertia: motion and loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glissando.geometry import se3
from glissando.io.atomic import write_table
from glissando.simulation.dynamics.motion import DynamicMotion

_PLACES, _RATE = 15, 100.0
_AXES = ("x", "y", "z")


def _six(linear: str, angular: str) -> list[str]:
    return [f"{linear}{a}" for a in _AXES] + [f"{angular}{a}" for a in _AXES]


def write_dynamics(motion: DynamicMotion, folder: Path) -> None:
    """Write truth.csv and loads.csv into a folder, SI units.

    truth.csv has pose, velocity, acceleration and the material's wrench (all body frame) at fifteen
    arclengths and a rate of 100 Hz; loads.csv has energies, works, the wrench on the base and
    tensions at every step.

    Args:
        motion: The motion.
        folder: Folder to write into.
    """
    time = np.arange(0.0, motion.time[-1] + 1e-9, 1.0 / _RATE)
    s = np.linspace(0.0, motion.rod.length, _PLACES)
    at = motion.at(s, time[:, None])
    first = np.stack(np.broadcast_arrays(time[:, None], s), axis=-1)
    quaternion = se3.quaternion(at.pose[..., :3, :3])
    parts = first, at.pose[..., :3, 3], quaternion, at.velocity, at.acceleration, at.wrench
    header = ["time", "arclength", *_AXES, "qw", "qx", "qy", "qz"]
    header += _six("v", "w") + _six("a", "alpha_") + _six("force_", "moment_")
    table = np.concatenate(parts, axis=-1).reshape(-1, len(header))
    write_table(folder / "truth.csv", header, table)
    e = motion.energies
    works = e.kinetic, e.strain, e.weight, e.supplied, e.contact, e.dissipated
    names = ["kinetic", "strain", "weight", "supplied", "contact", "dissipated"]
    header = ["time", *names, *_six("base_force_", "base_moment_")]
    header += [f"tension_{k + 1}" for k in range(motion.tensions.shape[1])]
    table = np.column_stack([motion.time, *works, motion.base_wrench, motion.tensions])
    write_table(folder / "loads.csv", header, table)
