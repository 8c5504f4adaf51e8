"""How far steps are damped, by how the steps before turned out."""

import numpy as np
import pytest

from glissando.solver.block_tridiagonal import BlockTridiagonal
from glissando.solver.damping import Damping

REFUSED = np.nan


class _Linearized:
    """A problem of one number, to read the damping off its step."""

    system = BlockTridiagonal(np.ones((1, 1, 1)), np.zeros((0, 1, 1)))
    rhs = scale = np.ones((1, 1))


def damping_of(damping):
    """Parts of the diagonal that the next step is damped by."""
    return float(1.0 / damping.step(_Linearized(), None).step[0, 0] - 1.0)


def after(*gains):
    damping = Damping(determined=False)
    for gain in gains:
        damping.adapt(gain)
    return damping_of(damping)


def test_whole_steps_are_taken_until_one_is_refused():
    assert after() == after(1.0) == after(0.5, 1.0) == 0.0
    assert after(REFUSED) == pytest.approx(1e-4)


def test_each_damping_that_is_refused_is_followed_by_four_times_as_much():
    assert after(REFUSED, REFUSED, REFUSED) == pytest.approx(1.6e-3)


def test_damping_that_helps_falls_until_a_whole_step_is_tried():
    kept = [after(REFUSED, *n * [1.0]) for n in range(1, 5)]
    assert np.all(np.diff(kept) < 0.0) or kept[-1] == 0.0
    assert kept[-1] == 0.0


def test_in_a_valley_where_whole_steps_are_refused_again_and_again_they_are_damped_ever_less():
    damping, least = Damping(determined=False), []
    for _ in range(4):
        while damping_of(damping) > 0.0:
            damping.adapt(1.0)
        damping.adapt(REFUSED)
        least.append(damping_of(damping))
    assert least[-1] == pytest.approx(1e-10, rel=1e-4)
    assert np.all(np.diff(least) < 0.0)


def test_a_smaller_first_damping_that_is_refused_is_followed_by_the_one_before():
    smaller = [REFUSED, *4 * [1.0], REFUSED]
    assert after(*smaller) == pytest.approx(1e-6)
    assert after(*smaller, REFUSED) == pytest.approx(1e-4)
    assert after(*smaller, REFUSED, REFUSED) == pytest.approx(4e-4)
