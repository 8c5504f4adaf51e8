"""Estimates of stiff robots whose cost bends more than its linearised residuals say converge."""

import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fast_motion
import real_slide
from glissando import Grid, estimate, load_robot
from glissando.io.recording_folder import load_recording

ROBOT = Path(__file__).parents[1] / "real.toml"

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("period", [0.5, 2.0])
def test_a_traverse_of_a_robot_that_is_touched_converges_where_steps_creep(spacetime, period):
    """Whole steps leap over the minimum there, and damped ones alone never end."""
    robot, window = load_robot(ROBOT), (10.0, 13.0)
    bodies = real_slide.load_bodies(load_recording(spacetime / "fast_contact"), robot, window)
    swing = [share * robot.length for share in real_slide.SWINGS["traverse"]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = real_slide.trial(bodies, robot, window, swing, period)
    assert arm.solve.converged
    assert arm.solve.iterations < 90


def test_a_rod_that_is_let_go_converges_though_loads_are_all_but_none(spacetime):
    """Whole steps lead there, though the first of them raise the cost a thousandfold."""
    options = SimpleNamespace(
        young=200e9, poisson=0.33, density=7870, radius=8e-4, length=0.6, seconds=1.0, modes=4
    )
    release = fast_motion.read_release(spacetime.parent / "sorosim" / "spring_steel_dynamics_3.txt")
    prior = fast_motion.moving(release, fast_motion.rod_of(release, options), options, 0.01)
    grid = Grid(np.linspace(0.0, 0.6, 9), np.arange(81) / 80.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solve = estimate(prior, grid, [fast_motion.coil(release, options, 0)], gate=None).solve
    assert solve.converged
    assert solve.iterations < 30
