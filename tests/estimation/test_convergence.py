"""What is said to have converged has: an end is where more steps lead nowhere else."""

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    CoilReadings,
    Grid,
    SensorParameter,
    SeparablePrior,
    SolverOptions,
    estimate,
)

TIME = np.array([0.0, 0.1, 0.25, 0.3, 0.5])
GRID = Grid([0.0, 0.05, 0.2, 0.4], TIME)


def frame_within(linear, angular):
    std = np.repeat((linear, angular), 3)
    return SensorParameter("frame", "frame", ("coil",), np.zeros(6), std)


@pytest.mark.parametrize("std", [None, (0.05, 0.2)])
def test_a_robot_that_bends_and_stretches_easily_ends_where_more_steps_do(std):
    """Its coil's roll goes along a curved valley by steps that hardly shrink."""
    soft = SeparablePrior(
        np.r_[[1e-3] * 3, [20.0] * 3],
        1.0,
        BaseVariance(np.r_[[1e-6] * 3, [1e-4] * 3], np.r_[[1e-3] * 3, [4.0] * 3]),
    )
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = np.c_[0.05 * np.sin(5.0 * TIME), 0.02 * TIME, np.full(5, 0.38)]
    cov = [1e-6] * 3 + [1e-4] * 2
    coil = CoilReadings(time=TIME, arclength=np.full(5, 0.4), values=poses, cov=cov, name="coil")
    frame = [] if std is None else [frame_within(*std)]
    problem = {"sensor_parameters": frame, "gate": None}
    found = estimate(soft, GRID, [coil], **problem)
    tight = SolverOptions(tolerance=1e-2, max_iterations=400)
    exact = estimate(soft, GRID, [coil], **problem, options=tight)
    assert found.solve.converged
    assert exact.solve.converged
    way = exact.state.difference(found.state).reshape(5, -1)
    off = way / np.sqrt(np.einsum("kii->ki", found.marginals.cov))[:, : way.shape[1]]
    assert np.abs(off).max() < 0.3
    assert exact.solve.cost == pytest.approx(found.solve.cost, abs=0.1)
