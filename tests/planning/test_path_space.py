"""Paths of a stage: whatever they are asked to follow, they keep every limit at every instant."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import cho_factor

from draws import generators
from glissando.errors import GlissandoError
from glissando.planning import PathSpace, path_space_of
from glissando.planning.optimize import descend
from glissando.planning.plan_slide import Plan
from glissando.simulation import SlideLimits
from slide_paths import require_within

TIP = 0.7
stages = st.builds(
    SlideLimits,
    stroke=st.floats(0.01, 0.7),
    speed=st.floats(0.005, 0.5),
    acceleration=st.floats(0.02, 5.0),
)


def targets(rng, space):
    """Anything at all: smooth, jumping, far off the slide."""
    span = space.upper - space.lower
    wild = rng.choice([0.1, 1.0, 5.0]) * span * rng.standard_normal(space.steps + 2)
    hold = int(rng.integers(1, 20))
    return space.lower + 0.5 * span + np.repeat(wild[::hold], hold)[: space.steps + 2]


@settings(max_examples=60, deadline=None)
@given(stages, st.floats(0.0, 1.0), generators)
def test_a_path_that_follows_any_target_keeps_every_limit_and_ends_at_rest(stage, share, rng):
    space = path_space_of(stage, TIP, TIP - share * stage.stroke, horizon=6.0)
    control = space.follow(targets(rng, space))
    plan = Plan(space.times, space.arclength(control), control, space, 0.0, {})
    path = plan.slide_path(TIP, stage)  # which refuses a path that does not
    require_within(path, stage)
    assert path.speed[-1] == 0.0
    assert path.displacement[0] == pytest.approx(TIP - space.start, abs=1e-12)
    rows, centre, width = space.polytope
    assert np.all(np.abs(rows @ control[2:-1] - centre) <= width * (1 + 1e-6) + 1e-12)
    np.testing.assert_allclose(space.control(control[2:-1]), control, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(stages, generators)
def test_a_path_can_be_left_at_any_knot_for_another_within_the_limits(stage, rng):
    space = path_space_of(stage, TIP, TIP - 0.3 * stage.stroke, horizon=6.0)
    time, place, speed = space.knots(space.follow(targets(rng, space)))
    at = int(rng.integers(1, 50))
    start = float(np.clip(place[at], space.lower, space.upper))
    begun = replace(space, start=start, start_speed=float(speed[at]))
    onward = begun.knots(begun.follow(targets(rng, begun)))
    joined = [np.concatenate([a[:at], b]) for a, b in zip((place, speed), onward[1:], strict=True)]
    assert np.all(joined[0] >= space.lower - 1e-9)
    assert np.all(joined[0] <= space.upper + 1e-9)
    sharpest = np.abs(np.diff(joined[1])).max() / 0.1
    assert sharpest <= stage.acceleration * (1 + 1e-6)
    assert np.abs(joined[1]).max() <= stage.speed * (1 + 1e-6)
    assert time[1] == pytest.approx(0.1)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(stages, st.floats(0.0, 1.0), generators)
def test_a_path_can_be_left_between_knots_near_an_end_of_the_slide(stage, share, rng):
    space = path_space_of(stage, TIP, TIP - 0.3 * stage.stroke, horizon=6.0)
    control = space.follow(targets(rng, space))
    plan = Plan(space.times, space.arclength(control), control, space, 0.0, {})
    place, speed = plan.at(plan.start + 0.1 * np.arange(1.0, 50.0) + 0.1 * share)
    for start, start_speed in zip(place, speed, strict=True):
        try:
            begun = replace(
                space, start=float(np.clip(start, space.lower, space.upper)),
                start_speed=float(start_speed),
            )  # fmt: skip
        except GlissandoError:
            continue  # it cannot be left here
        control = begun.follow(targets(rng, begun))
        onward = Plan(begun.times, begun.arclength(control), control, begun, 0.0, {})
        path, speeds = onward.at(np.linspace(onward.start, onward.start + 6.0, 6001))
        assert path.min() >= space.lower - 1e-9
        assert path.max() <= space.upper + 1e-9
        assert np.abs(np.diff(speeds)).max() <= 1e-3 * stage.acceleration * (1 + 1e-6) + 1e-12
        rows, centre, width = begun.polytope
        assert np.all(np.abs(rows @ control[2:-1] - centre) <= width * (1 + 1e-6) + 1e-12)


def test_a_target_that_can_be_met_is_met_without_overshooting():
    control = PathSpace(0.6, 0.7, 0.05, 0.2, 0.1, 60, 0.7).follow(np.full(62, 0.65))
    assert control[-1] == pytest.approx(0.65, abs=1e-6)
    assert np.all(np.diff(control) <= 1e-12)


@pytest.mark.parametrize(
    ("speed", "start", "message"),
    [
        (0.05, (0.6999, 0.05), "cannot stop within its limits"),
        (0.05, (0.5,), r"0.5 m, off its slide from 0.6 to 0.7 m"),
        (0.0, (0.65,), "nowhere to go"),
    ],
)
def test_a_start_that_cannot_be_left_is_refused_in_a_sentence(speed, start, message):
    with pytest.raises(GlissandoError, match=message):
        PathSpace(0.6, 0.7, speed, 0.2, 0.1, 60, *start)


@settings(max_examples=20, deadline=None)
@given(generators)
def test_descent_in_a_polytope_finds_the_least_of_a_bowl_and_never_leaves(rng):
    """Against the projection that a solver of quadratic programs finds."""
    from scipy.optimize import LinearConstraint, minimize

    rows = np.vstack([np.eye(4), np.diff(np.eye(4), axis=0)])
    polytope = rows, np.zeros(7), np.repeat([1.0, 0.5], [4, 3])
    aim, root = 2.0 * rng.standard_normal(4), rng.standard_normal((4, 4))
    bowl = root @ root.T + 0.3 * np.eye(4)

    def free(x):
        return 1.0 + 0.5 * (x - aim) @ bowl @ (x - aim), bowl @ (x - aim)

    def value(x):
        assert np.all(np.abs(rows @ x) < polytope[2])
        return free(x)

    point, least = descend(value, np.zeros(4), polytope, 80, tolerance=1e-9)
    limits = LinearConstraint(rows, -polytope[2], polytope[2])
    best = minimize(free, np.zeros(4), jac=True, method="SLSQP", constraints=limits)
    assert least <= best.fun * 1.002
    assert least == value(point)[0]


@pytest.mark.parametrize("seed", [30, 43, *range(8)])  # 2 of 60 met a singular curvature
def test_a_descent_among_kinks_ends_inside_however_long_it_is(seed):
    """On the largest of planes, whose gradient stands still, then jumps."""
    rng = np.random.default_rng(seed)
    size = rng.integers(2, 40)
    more = rng.integers(size, 3 * size)
    rows = np.vstack([np.eye(size), rng.normal(size=(more, size))])
    polytope = rows, np.zeros(len(rows)), rng.uniform(0.5, 2.0, len(rows))
    planes, heights = rng.normal(size=(6, size)), rng.normal(size=6)

    def highest(x):
        values = planes @ x + heights
        return values.max() + 10.0, planes[np.argmax(values)]

    point, least = descend(highest, np.zeros(size), polytope, 500, tolerance=1e-9)
    assert least == highest(point)[0] <= highest(np.zeros(size))[0]
    assert np.all(np.abs(rows @ point) < polytope[2])


@pytest.mark.slow
def test_the_limits_of_a_long_path_cost_a_step_of_its_descent_little():
    """Less than the factor of its curvature: of each limit three control points at most count."""
    space = PathSpace(0.6, 0.7, 0.024, 0.1, 0.1, 1500, 0.65)
    bowl = np.diag(np.linspace(1.0, 2.0, space.steps - 1))

    def value(x):
        return 1.0 + 0.5 * (x - 0.64) @ bowl @ (x - 0.64), bowl @ (x - 0.64)

    start = np.full(space.steps - 1, 0.65)
    begun = time.process_time()
    for _ in range(3):
        cho_factor(bowl + 0.1)
    factors = time.process_time() - begun
    begun = time.process_time()
    descend(value, start, space.polytope, 3)
    assert time.process_time() - begun < 5.0 * factors
