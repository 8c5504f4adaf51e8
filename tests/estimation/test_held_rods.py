"""Rods bent so far that only their loads hold them are found from readings of one moment."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from glissando import CoilReadings, estimate_static
from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.simulation import Rod

ROD = Rod.of_tubes(0.6, [(1.6e-3, 0.0)], young=60e9, poisson=0.33, density=6450)
PLACES = np.array([0.014, 0.07, 0.15, 0.23, 0.286, 0.3, 0.314, 0.37, 0.45, 0.53, 0.586, 0.6])
WEIGHT = np.array([0.0, 0.0, -9.81])


def carried(base, middle):
    """Poses (M, 4, 4) at the places of a rod that carries a wrench at its base, in the world.

    In its middle another is taken off. It is in balance with whatever it carries at its tip, and
    need not stay so.
    """

    def along(_, y):
        turn, force, moment = y[3:12].reshape(3, 3), y[12:15], y[15:]
        strain = np.append(force @ turn, moment @ turn) / ROD.stiffness + [0, 0, 1, 0, 0, 0]
        ahead = turn @ strain[:3]
        bent = turn @ se3.hat3(strain[3:])
        loads = -ROD.mass_per_length * WEIGHT, -np.cross(ahead, force)
        return np.concatenate([ahead, bent.ravel(), *loads])

    y, out = np.concatenate([np.zeros(3), np.eye(3).ravel(), base]), []
    for begin, end, off in ((0.0, 0.3, middle), (0.3, 0.6, np.zeros(6))):
        at = PLACES[(begin < PLACES) & (end >= PLACES)]
        piece = solve_ivp(along, (begin, end), y, t_eval=at, rtol=1e-9, atol=1e-10).y
        out.append(piece.T)
        y = piece[:, -1] - np.concatenate([np.zeros(12), off])
    rows = np.concatenate(out)
    pose = np.tile(np.eye(4), (len(rows), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rows[:, 3:12].reshape(-1, 3, 3), rows[:, :3]
    return pose


@pytest.mark.slow
@pytest.mark.parametrize("draw", [3, 12])
def test_a_rod_is_found_where_its_loads_hold_it_as_it_would_not_stay(draw):
    rng, noise = np.random.default_rng([0, draw]), np.repeat([7e-4, 7e-3], [3, 2])
    middle = np.repeat([0.12, 0.05], 3) * rng.standard_normal(6)
    pose = carried(np.repeat([0.17, 0.06], 3) * rng.standard_normal(6), middle)
    read = rng.choice(PLACES.size, 5, replace=False)
    off, roll = np.zeros((2, 5, 6))
    off[:, :5] = noise * rng.standard_normal((5, 5))
    roll[:, 5] = rng.uniform(-3.0, 3.0, 5)
    values = pose[read] @ se3.exp(off) @ se3.exp(roll)
    coil = CoilReadings(time=np.zeros(5), arclength=PLACES[read], values=values, cov=noise**2)
    prior = MechanicalPrior(
        Mechanics(ROD.stiffness[None], np.array([ROD.mass_per_length]), gravity=WEIGHT),
        psd_load=np.repeat([1e-8, 1e-12], 3),
        psd_strain_error=np.repeat([1e-10, 1e-6], 3),
        var_tip=np.repeat([0.21**2, 0.1**2], 3),
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        points=np.array([0.3]),
        var_points=np.repeat([[0.12**2, 0.05**2]], 3, axis=1),
    )
    found = estimate_static(prior, np.linspace(0.0, 0.6, 7), [coil])
    assert found.converged.all()
    at = found.at(PLACES, 0)
    gap = pose[:, :3, 3] - at.position
    cov = at.cov_position_world + 1e-9 * np.eye(3)
    assert np.einsum("mi,mi->m", gap, np.linalg.solve(cov, gap[..., None])[..., 0]).max() < 25.0
