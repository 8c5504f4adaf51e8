"""Motions of the robot: drawn as asked, and ranked by the uncertainty that they leave."""

import pickle

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.planning import (
    Trace,
    draw_motions,
    evaluate_path,
    expected_motion,
    plan_jointly,
    predict_information,
    sliding_sensor,
)
from plans import REACH, ROBOTS, ZONE, small_problem, small_space

kinds = pytest.mark.parametrize("kind", ROBOTS)


def test_an_expected_motion_has_the_rates_of_its_shapes():
    """Those of a robot that curls by 1 rad/m a second."""
    prior, nodes = ROBOTS["separable"].prior, ROBOTS["separable"].arclength_nodes

    def shape(arclength, time):
        strain = np.zeros((*np.broadcast(arclength, time).shape, 6))
        strain[..., 2], strain[..., 3] = 1.0, time
        return se3.exp(arclength[..., None] * strain), strain

    motion, time = expected_motion(shape, prior, nodes), np.array([0.5, 1.0])
    at, ahead = motion(time), motion(time + 1e-4)
    velocity = se3.log(se3.inverse(at.pose) @ ahead.pose) / 1e-4
    np.testing.assert_allclose(at.velocity, velocity, atol=1e-4)
    np.testing.assert_allclose(at.strain_rate[..., 3], 1.0, atol=1e-9)


def bent(robot, *curvatures):
    """Strains (S, N, 6) of circular arcs about body x."""
    strain = np.zeros((len(curvatures), robot.arclength_nodes.size, 6))
    strain[..., 2], strain[..., 3] = 1.0, np.array(curvatures)[:, None]
    return strain


@kinds
def test_a_drawn_motion_leads_at_rest_from_the_present_shape_to_one_between_those_given(kind):
    robot = ROBOTS[kind]
    for motion in draw_motions(robot, bent(robot, -2.0, 3.0), 5, 4.0, seed=1):
        at = pickle.loads(pickle.dumps(motion))(np.linspace(0.0, 4.0, 41))
        np.testing.assert_allclose(at.pose[0], robot.prior.rest_state(robot.grid(0, 1)).pose[0])
        np.testing.assert_allclose(at.pose[:, 0], at.pose[:1, 0].repeat(41, axis=0))
        np.testing.assert_allclose(at.velocity[[0, -1]], 0.0, atol=0.02)
        assert np.all(np.abs(at.strain[-1, :, 3] - 0.5) <= 2.5)
        ends = se3.inverse(at.pose[-1, :1]) @ at.pose[-1]
        arc = se3.exp(robot.arclength_nodes[:, None] * at.strain[-1])  # a constant strain
        np.testing.assert_allclose(ends, arc, atol=1e-9)


@kinds
def test_the_first_joint_plan_leaves_least_and_no_more_than_holding_still(kind):
    robot, still = ROBOTS[kind], small_problem(kind, 2.0)
    motions = draw_motions(robot, bent(robot, 4.0, -4.0), 3, 2.0)
    ranked = plan_jointly(robot, motions, small_space(still), [ZONE], sliding_sensor(robot))
    assert len(ranked) == 4
    assert ranked[0].motion is not None  # a bent body tells a coil more
    values = [joint.evaluation.value for joint in ranked]
    assert values == sorted(values)
    assert values[0] < values[-1]
    for joint in ranked:
        problem = predict_information(robot, REACH, 2.0, motion=joint.motion)
        value = evaluate_path(problem, [ZONE], Trace(), joint.plan.arclength).value
        assert value == pytest.approx(joint.evaluation.value)


def test_shapes_off_the_nodes_are_refused_in_a_sentence():
    robot = ROBOTS["separable"]
    with pytest.raises(GlissandoError, match=r"give \(S, 5, 6\), one or more"):
        draw_motions(robot, bent(robot, 1.0)[:, :4], 3, 2.0)
