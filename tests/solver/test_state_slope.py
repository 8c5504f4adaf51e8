"""Slopes of the state along arclength and time, which tell offsets and delays."""

import numpy as np
import pytest

from glissando import Grid, load_robot
from glissando.solver.measurement_factors import state_slope

SINCE_1970 = 1.7e9  # s


@pytest.mark.parametrize("span", [0.06, 0.3, 3.0])
@pytest.mark.parametrize("name", ["tdcr466", "tdcr466-segments"])
def test_slopes_do_not_depend_on_where_a_clock_begins(name, span):
    """Where times round by more than a nudge they were nothing divided by nothing."""
    robot, rng = load_robot(name), np.random.default_rng(0)
    time = np.linspace(0.0, span, 4)
    prior, where = robot.prior, rng.uniform(0.0, robot.length, 8)
    when, state = rng.uniform(0.0, span, 8), prior.rest_state(Grid(robot.arclength_nodes, time))
    state = state.retract(0.01 * rng.standard_normal((*state.pose.shape[:2], state.dof)))
    early, late = (
        state_slope(
            prior, Grid(robot.arclength_nodes, begin + time), state, where, begin + when, "time"
        )
        for begin in (0.0, SINCE_1970)
    )
    assert np.abs(late - early).max() < 0.1 * np.abs(early).max()
