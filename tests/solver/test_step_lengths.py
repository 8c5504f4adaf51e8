"""An iteration ends where what is left to go is short, however slowly its steps shrink."""

from itertools import pairwise

import numpy as np
import pytest

from glissando.solver.step_lengths import StepLengths


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("rate", [0.01, 0.3, 0.6, 0.9])
def test_steps_that_shrink_evenly_end_within_the_tolerance_of_their_limit(rate, weighted):
    steps, length = StepLengths(0.3, kinks=False, weighted=weighted), 100.0
    while not steps.short:
        steps.note(length, damped=False, renewed=False)
        length *= rate
    assert length / (1.0 - rate) < 0.3
    assert steps.first == 100.0


def test_a_step_far_shorter_than_the_one_before_ends_unless_weights_depend_on_residuals():
    for weighted in (False, True):
        steps = StepLengths(0.3, kinks=False, weighted=weighted)
        for length in (400.0, 4.0):
            assert not steps.short
            steps.note(length, damped=False, renewed=False)
        assert steps.short != weighted


def test_the_first_step_is_short_by_its_own_length_alone():
    steps = StepLengths(0.3, kinks=False, weighted=False)
    steps.note(4.0, damped=False, renewed=False)
    assert not steps.short


def test_steps_that_no_longer_shrink_end_only_where_readings_move_across_nodes():
    for kinks in (False, True):
        steps = StepLengths(0.3, kinks=kinks, weighted=False)
        for length in (50.0, 0.5, 0.4, 0.4):
            steps.note(length, damped=False, renewed=False)
        assert steps.short == kinks


def test_damped_steps_end_nothing():
    steps = StepLengths(0.3, kinks=True, weighted=True)
    for length in (1.0, 0.1, 0.0):
        steps.note(length, damped=True, renewed=False)
        assert not steps.idle
    steps.note(0.0, damped=False, renewed=True)
    steps.note(np.float64(0.0), damped=False, renewed=True)
    assert steps.short


def test_steps_that_gain_nothing_for_long_stall():
    steps = StepLengths(0.3, kinks=False, weighted=False)
    assert not any(steps.stall(10.0 - 0.1 * k) for k in range(10))
    assert any(steps.stall(9.0 - 1e-3 * k) for k in range(10))


def test_steps_creep_once_five_in_a_row_were_damped():
    steps = StepLengths(0.3, kinks=False, weighted=False)
    crept = []
    for damped in [True] * 4 + [False] + [True] * 6:
        steps.note(1.0, damped=damped, renewed=False)
        crept.append(steps.creep)
    assert crept == [False] * 9 + [True] * 2


def test_weights_that_are_renewed_begin_a_series_of_costs():
    steps = StepLengths(0.3, kinks=True, weighted=True)
    assert not any(steps.stall(10.0) for _ in range(5))
    steps.note(1.0, damped=False, renewed=True)
    assert not any(steps.stall(10.0) for _ in range(5))
    assert steps.stall(10.0)


def test_a_sudden_end_is_doubted_until_the_next_step_is_as_short_as_was_promised():
    steps = StepLengths(0.3, kinks=False, weighted=False)
    for length in (30.0, 0.8):
        steps.note(length, damped=False, renewed=False)
    assert steps.short
    assert steps.doubtful
    assert steps.confirms(0.02)
    assert not steps.confirms(0.5)
    steps.note(0.01, damped=False, renewed=False)
    assert not steps.doubtful


def test_a_next_step_not_far_shorter_than_the_last_has_to_be_taken_before_it_counts():
    """Along a curved valley steps go on as long as that, though the first was a long one."""
    steps = StepLengths(0.3, kinks=False, weighted=False)
    for length in (30.0, 0.8):
        steps.note(length, damped=False, renewed=False)
    assert not steps.confirms(0.2)
    steps.note(0.1, damped=False, renewed=False)
    assert steps.confirms(0.02)


@pytest.mark.parametrize(("length", "turns_back", "ends"), [
    (0.15, True, True), (0.15, False, False), (0.4, True, False),
])  # fmt: skip
def test_weights_that_go_to_and_fro_by_less_than_the_tolerance_end(length, turns_back, ends):
    steps = StepLengths(0.3, kinks=False, weighted=False)
    for _ in range(2):
        steps.note(length, damped=False, renewed=True, turns_back=turns_back)
    assert steps.last == ends


@pytest.mark.parametrize("rate", [0.5, 0.7, 0.85])
def test_steps_that_shrink_unevenly_end_within_the_tolerance_of_where_they_lead(rate):
    """Every other step is renewed and a third one longer than the one before, as weights move."""
    pattern, steps = (1.0, 0.45, 0.9), StepLengths(0.3, kinks=False, weighted=True)
    lengths = [80.0 * pattern[k % 3] * rate**k for k in range(200)]
    for k, length in enumerate(lengths):
        steps.note(length, damped=False, renewed=False)
        steps.note(1.01 * length, damped=False, renewed=True)
        if steps.short and steps.confirms(lengths[k + 1]):
            break
    left = sum(lengths[k + 1 :])
    assert left < 0.3
    assert left > 0.3 * rate**8  # and not long after


def test_steps_that_hardly_shrink_any_more_end_nothing_however_long_the_first_ones_were():
    steps = StepLengths(0.3, kinks=False, weighted=True)
    lengths = (500.0, 40.0, 3.0, 0.25, 0.22, 0.2, 0.19, 0.18, 0.175, 0.17)
    for length, following in pairwise(lengths):
        steps.note(length, damped=False, renewed=False)
        assert not (steps.short and steps.confirms(following))


def test_damped_steps_say_nothing_of_how_whole_ones_shrink():
    steps = StepLengths(0.3, kinks=False, weighted=True)
    for length, damped in ((9.0, False), (6.0, False), (0.01, True), (0.29, False), (0.28, False)):
        steps.note(length, damped=damped, renewed=False)
    assert not steps.short
