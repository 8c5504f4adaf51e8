"""Paths of a track: whatever they are asked, they keep every limit at every instant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import generators
from glissando.errors import GlissandoError
from glissando.planning import PathSpace, track_of
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


def path_of(track, control, stage):
    return Plan(track.times, track.places(control), control, track, 0.0, {}).slide_path(TIP, stage)


def wishes(rng, track):
    """Anything at all: smooth, jumping, far off the slide."""
    span = track.upper - track.lower
    wild = rng.choice([0.1, 1.0, 5.0]) * span * rng.standard_normal(track.steps + 2)
    hold = int(rng.integers(1, 20))
    return track.lower + 0.5 * span + np.repeat(wild[::hold], hold)[: track.steps + 2]


@settings(max_examples=60, deadline=None)
@given(stages, st.floats(0.0, 1.0), generators)
def test_a_path_that_follows_any_wish_keeps_every_limit_and_ends_at_rest(stage, share, rng):
    track = track_of(stage, TIP, TIP - share * stage.stroke, horizon=6.0)
    control = track.follow(wishes(rng, track))
    path = path_of(track, control, stage)  # which refuses a path that does not
    require_within(path, stage)
    assert path.speed[-1] == 0.0
    assert path.displacement[0] == pytest.approx(TIP - track.start, abs=1e-12)
    rows, centre, width = track.body
    assert np.all(np.abs(rows @ control[2:-1] - centre) <= width * (1 + 1e-6) + 1e-12)
    np.testing.assert_allclose(track.whole(control[2:-1]), control, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(stages, generators)
def test_a_path_can_be_left_at_any_knot_for_another_within_the_limits(stage, rng):
    track = track_of(stage, TIP, TIP - 0.3 * stage.stroke, horizon=6.0)
    time, place, speed = track.knots(track.follow(wishes(rng, track)))
    at = int(rng.integers(1, 50))
    begun = PathSpace(
        track.lower, track.upper, track.speed, track.acceleration, 0.1, 60,
        float(np.clip(place[at], track.lower, track.upper)), float(speed[at]),
    )  # fmt: skip
    onward = begun.knots(begun.follow(wishes(rng, begun)))
    joined = [np.concatenate([a[:at], b]) for a, b in zip((place, speed), onward[1:], strict=True)]
    assert np.all(joined[0] >= track.lower - 1e-9)
    assert np.all(joined[0] <= track.upper + 1e-9)
    sharpest = np.abs(np.diff(joined[1])).max() / 0.1
    assert sharpest <= stage.acceleration * (1 + 1e-6)
    assert np.abs(joined[1]).max() <= stage.speed * (1 + 1e-6)
    assert time[1] == pytest.approx(0.1)


def test_a_wish_that_can_be_met_is_met():
    track = PathSpace(0.6, 0.7, 0.05, 0.2, 0.1, 60, 0.7)
    held = track.follow(np.full(62, 0.65))
    assert held[-1] == pytest.approx(0.65, abs=1e-6)
    assert np.all(np.diff(held) <= 1e-12)  # without overshooting


def test_a_start_that_cannot_stop_is_refused_in_a_sentence():
    with pytest.raises(GlissandoError, match="cannot stop within its limits"):
        PathSpace(0.6, 0.7, 0.05, 0.2, 0.1, 60, 0.6999, 0.05)
    with pytest.raises(GlissandoError, match=r"0.5 m, off its slide from 0.6 to 0.7 m"):
        PathSpace(0.6, 0.7, 0.05, 0.2, 0.1, 60, 0.5)
    with pytest.raises(GlissandoError, match="nowhere to go"):
        PathSpace(0.6, 0.7, 0.0, 0.2, 0.1, 60, 0.65)


@settings(max_examples=20, deadline=None)
@given(generators)
def test_descent_in_a_body_finds_the_least_of_a_bowl_and_never_leaves(rng):
    """Against the projection that a solver of quadratic programs finds."""
    from scipy.optimize import LinearConstraint, minimize

    rows = np.vstack([np.eye(4), np.diff(np.eye(4), axis=0)])
    body = rows, np.zeros(7), np.repeat([1.0, 0.5], [4, 3])
    aim, root = 2.0 * rng.standard_normal(4), rng.standard_normal((4, 4))
    bowl = root @ root.T + 0.3 * np.eye(4)

    def value(x):
        assert np.all(np.abs(rows @ x) < body[2])
        return 1.0 + 0.5 * (x - aim) @ bowl @ (x - aim), bowl @ (x - aim)

    def free(x):
        return 1.0 + 0.5 * (x - aim) @ bowl @ (x - aim), bowl @ (x - aim)

    found, least = descend(value, np.zeros(4), body, 80, tolerance=1e-9)
    limits = LinearConstraint(rows, -body[2], body[2])
    best = minimize(free, np.zeros(4), jac=True, method="SLSQP", constraints=limits)
    assert least <= best.fun * 1.002
    assert least == value(found)[0]
