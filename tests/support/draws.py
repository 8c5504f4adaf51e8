"""Random poses, states and motions for laws over inputs, always drawn from a given generator."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from glissando.geometry import se3
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.state import State

law = settings(deadline=None, derandomize=True, max_examples=50)
generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def directions(rng, *shape):
    """Unit three-vectors."""
    v = rng.standard_normal((*shape, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def sixes(rng, *shape, reach=1.0, angle=1.0):
    """Six-vectors with linear entries of size `reach` and exactly this angle."""
    linear = reach * rng.standard_normal((*shape, 3))
    return np.concatenate([linear, angle * directions(rng, *shape)], axis=-1)


def poses(rng, *shape, reach=1.0, largest_angle=3.0):
    """Poses turned by up to `largest_angle`."""
    angle = largest_angle * rng.uniform(size=(*shape, 1))
    return se3.exp(sixes(rng, *shape, reach=reach, angle=angle))


def states(rng, *shape, bend=2.0, speed=1.0):
    """States anywhere: strains near a straight rod's, bent by `bend` rad/m, turning at `speed`."""
    strain = np.array([0, 0, 1.0, 0, 0, 0]) + sixes(rng, *shape, reach=0.05, angle=bend)
    return State(poses(rng, *shape), strain, sixes(rng, *shape, reach=0.5 * speed, angle=speed))


def motion(rng, grid, *, bend=2.0, speed=1.0, wander=0.05):
    """A bent and moving rod on a grid whose neighbours nearly agree, as at an estimate."""
    k_count, n_count = grid.shape
    strain = np.array([0, 0, 1.0, 0, 0, 0]) + sixes(rng, reach=0.02, angle=bend)
    velocity = sixes(rng, reach=0.3 * speed, angle=speed)
    along = se3.exp(grid.arclength[:, None] * strain)
    swing = se3.exp(grid.time[:, None] * velocity)
    pose = poses(rng) @ swing[:, None] @ along
    shape = (k_count, n_count, 6)
    state = State(pose, np.broadcast_to(strain, shape), np.broadcast_to(velocity, shape))
    return state.retract(wander * rng.standard_normal((k_count, n_count, 18)))


def prior(*, base=True, **changes):
    """A prior of a soft rod half a metre long, with every density different."""
    rise = np.linspace(0.8, 1.2, 6)
    firmness = BaseDensity(1e-3 * rise, np.r_[1e-3, 1e-3, 1e-3, 2.0, 2.0, 2.0], rise)
    settings = {
        "psd_velocity_time": 2.0 * rise,
        "psd_strain_arclength": np.r_[1e-3, 1.2e-3, 2e-3, 3.0, 4.0, 2.0],
        "psd_strain_time": np.r_[1e-2, 2e-2, 1e-2, 5.0, 6.0, 7.0],
        "psd_velocity_arclength": 3.0 * rise[::-1],
        "base": firmness if base else None,
    }
    return WhiteNoisePrior(**{**settings, **changes})


def spd(rng, *shape, size):
    """Symmetric positive definite matrices."""
    root = rng.standard_normal((*shape, size, size))
    return root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(size)
