"""The system of a sliding window answers to another right-hand side as to its own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from draws import law
from glissando.estimation.window_system import WindowSystem
from glissando.solver.normal_equations import Layout

SIZE = 3


def summed(system, first, rng):
    """Sums of factors between slabs side by side, drawn, from slab `first` on."""
    builder = system.builder(first)
    count = len(builder.begin)
    for k in range(count):
        slopes = rng.standard_normal((2 * SIZE + 1, 2 * SIZE))
        residual = rng.standard_normal(2 * SIZE + 1)
        begin, end = slopes[:, :SIZE], slopes[:, SIZE:]
        builder.begin[k] += begin.T @ begin
        builder.rhs_begin[k] -= begin.T @ residual
        if k + 1 < count:
            builder.end[k] += end.T @ end
            builder.across[k] += end.T @ begin
            builder.rhs_end[k] -= end.T @ residual
    return builder


@law
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 12))
def test_another_right_hand_side_is_followed_through_steps_that_come_and_go(seed, lag, steps):
    rng = np.random.default_rng(seed)
    system = WindowSystem(Layout(1, SIZE), np.eye(SIZE), np.zeros(SIZE))
    for _ in range(steps):
        first = int(rng.integers(0, max(len(system) - 1, 1)))  # the new slab's interval counts
        sums = summed(system, first, rng)
        wanted = system.solve(first, sums)
        assert np.allclose(system.respond(first, sums), wanted, rtol=1e-9, atol=1e-9)
        while len(system) > lag:
            system.drop()
        system.append()
