"""Motions of the robot: drawn as asked, and the one that leaves least uncertain is chosen."""

import pickle

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.planning import (
    Trace,
    belief_of,
    choose_motion,
    course_of,
    draw_motions,
    evaluate_path,
    plan_together,
    predict_information,
    sliding_sensor,
)
from plans import REACH, ROBOTS, ZONE, small_outlook, small_track, wiggle

kinds = pytest.mark.parametrize("kind", ROBOTS)


def bending(rate):
    """A robot that curls by `rate` rad/m a second."""

    def shape(arclength, time):
        strain = np.zeros((*np.broadcast(arclength, time).shape, 6))
        strain[..., 2], strain[..., 3] = 1.0, rate * time
        return se3.exp(arclength[..., None] * strain), strain

    return shape


@kinds
def test_the_motion_that_leaves_least_uncertain_is_chosen(kind):
    robot = ROBOTS[kind]
    outlooks = [
        small_outlook(kind, course=course_of(bending(rate), robot.prior, robot.arclength_nodes))
        for rate in (0.0, 1.0, 2.0)
    ]
    path = wiggle(outlooks[0])
    chosen, values = choose_motion(outlooks, [ZONE], Trace(), path)
    whole = [evaluate_path(outlook, [ZONE], Trace(), path).value for outlook in outlooks]
    assert chosen == int(np.argmin(values)) == int(np.argmin(whole))
    assert np.ptp(whole) > 0.01 * np.mean(whole)


def test_a_course_gives_the_rates_of_its_shapes():
    prior, nodes = ROBOTS["separable"].prior, ROBOTS["separable"].arclength_nodes
    at = course_of(bending(1.0), prior, nodes)(np.array([0.5, 1.0]))
    ahead = course_of(bending(1.0), prior, nodes)(np.array([0.5, 1.0]) + 1e-4)
    turned = se3.log(se3.inverse(at.pose) @ ahead.pose) / 1e-4
    np.testing.assert_allclose(at.velocity, turned, atol=1e-4)
    np.testing.assert_allclose(at.strain_rate[..., 3], 1.0, atol=1e-9)


def bent(robot, *curvatures):
    """Strains (S, N, 6) of circular arcs about body x."""
    strain = np.zeros((len(curvatures), robot.arclength_nodes.size, 6))
    strain[..., 2] = 1.0
    strain[..., 3] = np.array(curvatures)[:, None]
    return strain


@kinds
def test_a_drawn_motion_leads_at_rest_from_the_present_shape_to_one_between_those_given(kind):
    robot = ROBOTS[kind]
    for seed, course in enumerate(draw_motions(robot, bent(robot, -2.0, 3.0), 5, 4.0, seed=1)):
        at = pickle.loads(pickle.dumps(course))(np.linspace(0.0, 4.0, 41))
        np.testing.assert_allclose(at.pose[0], robot.prior.rest_state(robot.grid(0, 1)).pose[0])
        np.testing.assert_allclose(at.pose[:, 0], at.pose[:1, 0].repeat(41, axis=0))
        np.testing.assert_allclose(at.velocity[[0, -1]], 0.0, atol=0.02)
        assert np.all(np.abs(at.strain[-1, :, 3] - 0.5) <= 2.5), seed
        ends = se3.inverse(at.pose[-1, :1]) @ at.pose[-1]
        arc = se3.exp(robot.arclength_nodes[:, None] * at.strain[-1])  # a constant strain
        np.testing.assert_allclose(ends, arc, atol=1e-9)


@kinds
def test_the_chosen_motion_with_its_plan_is_no_worse_than_holding_still(kind):
    robot = ROBOTS[kind]
    track = small_track(small_outlook(kind, 2.0))
    courses = draw_motions(robot, bent(robot, 4.0, -4.0), 3, 2.0)
    ranked = plan_together(robot, courses, track, [ZONE], sliding_sensor(robot))
    still = small_outlook(kind, 2.0)
    nominal = next(found for found in ranked if found.course is None)
    told = evaluate_path(still, [ZONE], Trace(), nominal.plan.arclength).value
    assert nominal.told.value == pytest.approx(told)
    assert ranked[0].told.value <= told
    assert ranked[0].course is not None  # a bent body tells a coil more
    assert len(ranked) == 4
    best = predict_information(robot, REACH, 2.0, course=ranked[0].course)
    path = ranked[0].plan.arclength
    assert evaluate_path(best, [ZONE], Trace(), path).value == pytest.approx(ranked[0].told.value)


def test_motions_that_cannot_be_are_refused_in_a_sentence():
    robot = ROBOTS["separable"]
    with pytest.raises(GlissandoError, match="no motion to choose"):
        choose_motion([], [ZONE], Trace(), wiggle(small_outlook()))
    with pytest.raises(GlissandoError, match=r"give \(S, 5, 6\), one or more"):
        draw_motions(belief_of(robot), bent(robot, 1.0)[:, :4], 3, 2.0)
