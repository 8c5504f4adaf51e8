"""The compiled intervals of a rod are the oracle's, at rest, in motion and under inertia."""

import numpy as np
import pytest

from glissando.geometry import se3
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical import intervals as compiled
from glissando.model.priors.mechanical.flow import Section
from glissando.model.priors.mechanical.intervals import Intervals
from glissando.model.priors.mechanical.tip import tip_error
from glissando.model.state import State
from oracles import rod_intervals as oracle

COUNT = 12


def drawn(seed, inertia):
    """Intervals, and moving nodes at both of their ends."""
    rng = np.random.default_rng(seed)
    stiffness, beyond = np.exp(rng.uniform(0.0, 6.0, (2, COUNT, 6))) * np.repeat([1e2, 1e-2], 3)
    rest, end_rest = 0.5 * rng.standard_normal((2, COUNT, 6)) * np.repeat([0.0, 1.0], 3)
    rest[:, 2] = end_rest[:, 2] = 1.0
    weight, weight_slope = rng.standard_normal((2, COUNT, 3))
    section = Section(
        stiffness, rest, 0.3 * rng.standard_normal((COUNT, 6)), weight,
        rng.uniform(1e-4, 1e-3, (COUNT, 12)), weight_slope,
    )  # fmt: skip
    step, mass = rng.uniform(0.01, 0.1, COUNT), rng.uniform(0.0, 0.3, COUNT)
    intervals = Intervals(step, section, beyond, end_rest, np.zeros((COUNT, 6)), mass)

    def node():
        pose = se3.exp(rng.standard_normal((COUNT, 6)))
        moves = rng.standard_normal((2, COUNT, 6)) * rng.choice([0.0, 1e-3, 1.0], (2, COUNT, 1))
        more = [rng.standard_normal((COUNT, 6))] if inertia else []
        strain = rest + 0.1 * rng.standard_normal((COUNT, 6)) / stiffness
        return State(pose, strain, *moves, *more)

    return intervals, node(), node(), rng


def same(found, expected):
    for one, other in zip(found, expected, strict=True):
        if isinstance(one, State):
            same(one.fields(), other.fields())
        else:
            scale = np.abs(other).max(initial=1e-12)
            np.testing.assert_allclose(one / scale, other / scale, atol=1e-9)


@pytest.mark.parametrize("inertia", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_errors_and_slopes_of_compiled_intervals_are_the_oracles(seed, inertia):
    intervals, start, end, rng = drawn(seed, inertia)
    for name in ("still_error", "interval_error"):
        given = start, end, intervals
        same(getattr(compiled, name)(*given), getattr(oracle, name)(*given))
    place = rng.uniform(0.1, 0.9, COUNT) * intervals.step, rng.standard_normal((COUNT, 12, 12))
    given = start, end, intervals, *place
    same(compiled.interval_between(*given), oracle.interval_between(*given))


@pytest.mark.parametrize("every", [False, True])
def test_the_compiled_tip_of_a_rod_is_the_oracles(every):
    """Under one gravity, or under one for each."""
    _, at, _, rng = drawn(5, False)
    gravity = rng.standard_normal((COUNT, 3) if every else 3)
    stiffness = np.exp(rng.standard_normal((1, 6)))
    mechanics = Mechanics(stiffness, np.zeros(1), gravity=gravity, tip_mass=0.3,
                          tip_center=rng.standard_normal(3))  # fmt: skip
    given = mechanics, rng.standard_normal(6), at
    same(tip_error(*given), oracle.tip_error(*given))
