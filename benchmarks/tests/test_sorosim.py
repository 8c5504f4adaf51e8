"""Rods at rest and in motion are those of another group's solver."""

from pathlib import Path

import numpy as np
import pytest

from glissando.simulation import Rod
from releases import AXES, read_release, simulate
from sorosim import FILE, differences

FOLDER = (Path(__file__).parents[2] / FILE).resolve().parent


@pytest.mark.slow
def test_five_hundred_shapes_of_another_groups_solver_are_ours():
    file = FOLDER / FILE.name
    if not file.is_file():
        pytest.skip("SoroSim's shapes are not beside the checkout")
    distance, angle = differences(file)
    tip = 1e3 * distance[:, -1]
    assert np.median(tip) < 0.15
    assert np.quantile(tip, 0.99) < 0.42
    assert 1e3 * distance.max() < 0.65
    assert np.degrees(angle.max()) < 0.35


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, 6))
def test_a_release_moves_as_another_groups_solver_says(number):
    file = (FOLDER / f"spring_steel_dynamics_{number}.txt").resolve()
    if not file.is_file():
        pytest.skip("SoroSim's releases are not beside the checkout")
    release = read_release(file)
    base = np.eye(4)
    base[:3, :3] = AXES
    material = {"young": 200e9, "poisson": 0.33, "density": 7870.0}
    rod = Rod.of_tubes(0.6, [(1.6e-3, 0.0)], base=base, **material, retardation=release.damping)
    motion = simulate(release, rod, 1.0)
    times = release.time[:201]
    ours = motion.at([[0.3], [0.6]], times).pose[..., :3, 3]
    error = np.sqrt(np.mean(np.sum((ours - release.place[:, :201]) ** 2, axis=-1), axis=1))
    share = error / np.linalg.norm(np.ptp(release.place[1, :201], axis=0))
    print(f"release {number}: middle {share[0]:.2%}, tip {share[1]:.2%} of the tip's travel")
    assert share.max() < 3e-3
