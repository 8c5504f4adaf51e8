"""What readings tell of parameters: slopes of their evidence, and information."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_learn_weight import LINEAR, MASS, hanging, hanging_robot

from glissando import GlissandoError
from glissando.calibration.robot import average_information
from glissando.calibration.robot.average_information import FINE, NUDGE, Change, EvidenceAt
from glissando.calibration.robot.hyperparameters import expanded, learnable, moved
from glissando.calibration.robot.objective import Objective
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.io.robot_file import parse_robot
from glissando.model.grid import uniform_grid
from glissando.model.sensors.sensors import PoseReadings
from glissando.model.table import Table
from learn_drawn import shipped

STILL = 0.01  # of the file's densities: motions so small that all is linear


def parsed(document):
    return parse_robot(Table(document, "drawn", GlissandoError))


def drawn_robot():
    """A robot of two segments that a tracker at its tip, which drifts, and one before it see."""
    document = expanded(shipped("tdcr466-segments"))
    document["grid"] = {"arclength_nodes": 3, "time_rate": 4.0}
    prior, base = document["prior"], document["base"]
    prior["time_scale"] = 0.8
    for table in (prior["psd_strain_arclength"], prior["var_jumps"], [base["var_strain"]]):
        for row in table:
            row[:] = [STILL * value for value in row]
    document["sensors"]["pose"].pop("loss")
    drift = {"name": "drift", "kind": "mount", "streams": ["p1"], "correlation_time": 0.5}
    document["sensor_parameters"] = [{**drift, "std": [2e-3] * 3 + [2e-2] * 3}]
    return document


@dataclass(frozen=True)
class Drawn:
    """Readings as a robot file says that they are taken, of values that were drawn once."""

    drawn: tuple = ()

    def grid(self, robot):
        return uniform_grid(robot.length, 3, 0.0, 1.25, 4.0)

    def layout(self, robot):
        time, still = np.linspace(0.0, 1.25, 11), np.broadcast_to(np.eye(4), (11, 4, 4))
        std = robot.sensor_std["pose"]
        return [
            PoseReadings(time=time, arclength=np.full(11, at), values=still, cov=std**2, name=name)
            for name, at in (("p0", 0.5 * robot.length), ("p1", robot.length))
        ]

    def readings(self, robot):
        pairs = zip(self.layout(robot), self.drawn, strict=True)
        return [replace(blank, values=each.values) for blank, each in pairs]

    def truth(self, robot):
        return []


class Long(Drawn):
    """The same on 200 time nodes, where the covariance of the states is rounded by more."""

    def grid(self, robot):
        return uniform_grid(robot.length, 3, 0.0, 50.0, 4.0)


def both_nudged(document, numbers):
    """The robot file with each number moved a little, and much less to both sides."""
    steps, ways = (NUDGE, FINE, -FINE), np.eye(len(numbers))
    return [tuple(moved(document, numbers, h * x) for h in steps) for x in ways]


@pytest.mark.slow
def test_slopes_are_zero_on_average_and_information_is_their_mean_product():
    document = drawn_robot()
    robot, rng = parsed(document), np.random.default_rng(4)
    words = ("pose noise, linear", "2, bending", "time scale", "spread linear", "correlation")
    every = learnable(document, ["pose"])
    numbers = [next(p for p in every if word in p.label) for word in words]
    nudged = both_nudged(document, numbers)
    blank = Drawn()
    world = PriorPredictive(robot, blank.grid(robot), blank.layout(robot))
    slopes, information = [], []
    for _ in range(80):
        cases = [Drawn(tuple(world.draw(rng).readings))]
        goal = Objective(cases, calibrate=False)
        centre = goal.score(document, goal.start())
        evidence = EvidenceAt(cases, document, centre.starts)
        changes = [evidence.change(*each) for each in nudged]
        slope, curvature = average_information.slopes(changes, 1)
        slopes.append(slope)
        information.append(curvature)
    slopes, expected = np.array(slopes), np.mean(information, axis=0)
    scale = np.sqrt(np.diag(expected))
    assert np.all(scale > 0.3)
    white = slopes / scale
    np.testing.assert_allclose(white.mean(axis=0), 0.0, atol=4.0 / np.sqrt(len(white)))
    np.testing.assert_allclose(
        white.T @ white / len(white), expected / np.outer(scale, scale), atol=0.5
    )


def test_numbers_on_which_nothing_depends_have_no_slope():
    document = drawn_robot()
    robot, blank = parsed(document), Drawn()
    world = PriorPredictive(robot, blank.grid(robot), blank.layout(robot))
    cases = [Long(tuple(world.draw(np.random.default_rng(1)).readings))]
    goal = Objective(cases, calibrate=False)
    evidence = EvidenceAt(cases, document, goal.score(document, goal.start()).starts)
    change = evidence.change(document, document, document)
    assert (change.misfit, change.width, change.shift) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("off", [-1.5, -0.3, 0.3, 1.5])
def test_a_scale_is_found_in_one_step(off):
    """Of a variance exp(z) times that of N numbers, by closed form."""
    count, wide = 50, np.exp(off)
    misfit, width = -0.5 * count / wide, 0.5 * count
    changes = np.full(count, np.sqrt(0.5 / wide))
    one = Change(misfit, width, 0.0, changes, changes)
    slope, information = average_information.slopes([one, None], count)
    assert -slope[0] / information[0, 0] == pytest.approx(-off, abs=abs(off) ** 3 / 20.0)
    assert slope[1] == 0.0
    assert not information[1].any()
    assert not information[:, 1].any()


@pytest.mark.slow
def test_slopes_by_a_weight_and_a_rest_shape_are_those_of_the_evidence():
    """They move what is expected by thousands of deviations, all but a few of which states take."""
    document = hanging_robot(MASS, 1.3 * LINEAR)
    document["rest_strain"] = [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]
    document = expanded(document)
    words = ("mass", "rest", "time scale", "load", "strain error", "tip")
    numbers = [p for p in learnable(document, []) if any(word in p.label for word in words)]
    hung = hanging(2)
    case = SimpleNamespace(
        grid=hung.grid,
        readings=lambda robot: hung.readings(robot) + hung.truth(robot),
        truth=lambda robot: [],
    )
    goal = Objective([case], calibrate=False)
    centre = goal.score(document, goal.start())
    evidence = EvidenceAt([case], document, centre.starts)
    changes = [evidence.change(*each) for each in both_nudged(document, numbers)]
    slope, information = average_information.slopes(changes, 1)
    assert max(change.shift for change in changes) > 1e3
    for number, found, known in zip(numbers, slope, np.diag(information), strict=True):
        scores = [goal.score(moved(document, [number], [h]), centre).score for h in (0.02, -0.02)]
        expected = -(scores[0].value - scores[1].value) * scores[0].samples / 0.04
        bend = 2.0 * centre.score.value - scores[0].value - scores[1].value
        assert found == pytest.approx(expected, rel=0.02, abs=0.2), number.label
        if any(word in number.label for word in ("mass", "rest")):
            assert known == pytest.approx(bend * scores[0].samples / 4e-4, rel=0.2), number.label
