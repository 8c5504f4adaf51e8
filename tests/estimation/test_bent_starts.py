"""Shapes bent by more than half a turn are found, or what contradicts itself says so."""

import tomllib
import warnings
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from glissando import (
    CoilReadings,
    Grid,
    PoseReadings,
    SolverOptions,
    estimate,
    estimate_static,
)
from glissando.errors import FalseConfidenceWarning, GlissandoError
from glissando.estimation import several_starts
from glissando.geometry import se3
from glissando.io.robot_file import parse_robot
from glissando.io.robot_template import RobotOutline, robot_text
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.table import Table
from glissando.simulation import Loads, Rod, Wrench, solve_shape
from glissando.solver.outcome import Outcome

LENGTH, COUNT = 0.466, 24


def robot(bend):
    """The file of a new robot of one segment that bends so far."""
    text = robot_text(RobotOutline("arc", LENGTH, 1, 0.012, bend, ["pose"]))
    return parse_robot(Table(tomllib.loads(text), "arc", GlissandoError))


def arcs(rng, least, most):
    """Strains (S, 6) of circular arcs in any direction."""
    turn, way = rng.uniform(least, most, COUNT), rng.uniform(0.0, 2.0 * np.pi, COUNT)
    zero = np.zeros(COUNT)
    bend = turn / LENGTH * np.array([np.cos(way), np.sin(way)])
    return np.stack([zero, zero, zero + 1.0, *bend, zero], axis=1)


def tips(rng, strain, std):
    """Readings of the tips, their time the number of the shape."""
    noise = std * rng.standard_normal((COUNT, 6))
    values = se3.exp(LENGTH * strain) @ se3.exp(noise)
    at = np.full(COUNT, LENGTH)
    return PoseReadings(time=np.arange(COUNT), arclength=at, values=values, cov=std**2, name="tip")


@pytest.mark.slow
def test_arcs_of_up_to_three_quarters_of_a_turn_are_found_from_the_tip_alone():
    arc, rng = robot(1.5 * np.pi), np.random.default_rng(0)
    strain = arcs(rng, 0.9 * np.pi, 1.5 * np.pi)
    tip = tips(rng, strain, arc.sensor_std["pose"])
    together = estimate_static(arc.prior, arc.arclength_nodes, [tip])
    for k in range(COUNT):
        one = tip.select(tip.time == k).changed(time=np.zeros(1))
        alone = estimate(arc.prior, Grid(arc.arclength_nodes, [0.0]), [one])
        assert not alone.solve.doubt
        middle = se3.exp(0.5 * LENGTH * strain[k])[:3, 3]
        for found in (alone.at(0.5 * LENGTH, 0.0), together.at(0.5 * LENGTH, k)):
            off = found.position - middle
            assert off @ np.linalg.solve(found.position_covariance(), off) < 25.0
    assert together.converged.all()


def _note(seen, number, cost, length):
    seen.append(number)


def wound(turn, way):
    """Poses (3, 4, 4) of two arcs in ways (2,) of their own: amid the first, and at both ends."""
    half = 0.5 * LENGTH
    bend = turn / half * np.array([np.cos(way), np.sin(way)])
    first, second = (np.array([0.0, 0.0, 1.0, *bend[:, i], 0.0]) for i in (0, 1))
    joint = se3.exp(half * first)
    return np.array([se3.exp(0.5 * half * first), joint, joint @ se3.exp(half * second)])


def of_two_segments():
    """The file of a new robot of two segments of up to three quarters of a turn each."""
    text = robot_text(RobotOutline("wound", LENGTH, 2, 0.012, 1.5 * np.pi, ["pose"]))
    return parse_robot(Table(tomllib.loads(text), "wound", GlissandoError))


def at_ends(rng, two, time, poses):
    """Readings (K,) of trackers at the ends of both segments, of poses (K, 3, 4, 4)."""
    std = two.sensor_std["pose"]
    return [
        PoseReadings(
            time=time,
            arclength=np.full(time.size, share * LENGTH),
            values=poses[:, i] @ se3.exp(std * rng.standard_normal((time.size, 6))),
            cov=np.tile(np.diag(std**2), (time.size, 1, 1)),
            name=f"tracker{i}",
        )
        for i, share in ((1, 0.5), (2, 1.0))
    ]


def test_a_report_counts_the_iterations_from_all_starts():
    """The pieces of the public contact once ended after "1 iteration", of a hundred before."""
    rng, two, several = np.random.default_rng(0), of_two_segments(), 0
    grid = Grid(two.arclength_nodes, [0.0])
    for _ in range(4):
        turn, way = rng.uniform(0.5 * np.pi, 1.5 * np.pi, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        tip, seen = at_ends(rng, two, np.zeros(1), wound(turn, way)[None])[1:], []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FalseConfidenceWarning)
            found = estimate(two.prior, grid, tip, progress=partial(_note, seen))
        assert found.solve.iterations == len(seen)
        several += seen.count(1) > 1
    assert several


def squared_miss(found, time, pose):
    """Squared normalised error of the place amid the first segment."""
    at = found.at(0.25 * LENGTH, time)
    off = at.position - pose[:3, 3]
    return off @ np.linalg.solve(at.cov_position_world, off)


@pytest.mark.slow
def test_two_segments_of_up_to_three_quarters_of_a_turn_each_are_found_from_their_ends():
    rng, two, time = np.random.default_rng(2), of_two_segments(), np.arange(5) / 30.0
    for _ in range(10):
        turn, way = rng.uniform(0.5 * np.pi, 1.5 * np.pi, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        poses = np.tile(wound(turn, way), (time.size, 1, 1, 1))
        found = estimate(two.prior, Grid(two.arclength_nodes, time), at_ends(rng, two, time, poses))
        assert not found.solve.doubt
        assert squared_miss(found, time[2], poses[2, 0]) < 25.0


@pytest.mark.slow
def test_two_segments_that_move_while_they_are_wound_are_found():
    """One shape is no start for all: pieces of a few moments lead from one to the next."""
    rng, two, time = np.random.default_rng(4), of_two_segments(), np.arange(46) / 30.0
    for _ in range(1):
        way = rng.uniform(0.0, 2.0 * np.pi, 2) + time[:, None] * rng.uniform(-2.5, 2.5, 2)
        turn = np.pi * (1.0 + 0.4 * np.sin(2.0 * time[:, None] + rng.uniform(0.0, 6.0, 2)))
        poses = np.array([wound(*each) for each in zip(turn, way, strict=True)])
        found = estimate(two.prior, Grid(two.arclength_nodes, time), at_ends(rng, two, time, poses))
        assert found.solve.converged
        assert not found.solve.doubt
        for k in (5, 20, 40):
            assert squared_miss(found, time[k], poses[k, 0]) < 25.0


@pytest.mark.parametrize(("bend", "doubtful"), [(0.2 * np.pi, True), (np.pi, False)])
def test_a_shape_that_bends_far_more_than_its_file_says_contradicts_it(bend, doubtful):
    arc, rng = robot(bend), np.random.default_rng(1)
    tip = tips(rng, arcs(rng, 0.8 * np.pi, np.pi), arc.sensor_std["pose"])
    one = tip.select(tip.time == 0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FalseConfidenceWarning)
        found = estimate(arc.prior, Grid(arc.arclength_nodes, [0.0]), [one])
    assert bool(found.solve.doubt) == bool(caught) == doubtful


@pytest.mark.slow
@pytest.mark.parametrize("draw", [32, 108, 147])
def test_a_rod_bent_by_loads_is_found_where_a_search_from_rest_goes_astray(draw):
    rng, length, nodes = np.random.default_rng([1001, draw]), 0.5, np.linspace(0.0, 0.5, 11)
    rod = Rod.of_tubes(length, [(1.2e-3, 0.0)], young=60e9, poisson=0.33, density=6450)
    std_tip, std_point = np.repeat([0.1, 2e-3], 3), np.repeat([0.1, 2e-4], 3)
    tip, point = std_tip * rng.standard_normal(6), std_point * rng.standard_normal(6)
    wrenches = [Wrench(length, tip[:3], tip[3:]), Wrench(0.3, point[:3], point[3:])]
    gravity, noise = np.array([0.0, 0.0, 9.81]), np.repeat([7e-4, 7e-3], [3, 2])
    truth = solve_shape(rod, [], Loads(gravity=gravity, wrenches=wrenches))
    off = se3.exp(np.append(noise * rng.standard_normal(5), rng.uniform(-np.pi, np.pi)))
    coil = CoilReadings(
        time=[0.0], arclength=[length], values=truth.at([length]).pose @ off, cov=noise**2
    )
    prior = MechanicalPrior(
        Mechanics(rod.stiffness[None], np.array([rod.mass_per_length]), gravity=gravity),
        psd_load=np.repeat([1e-7, 1e-11], 3),
        psd_strain_error=np.repeat([1e-12, 1e-8], 3),
        var_tip=std_tip**2,
        time_scale=1.0,
        var_base=np.full(6, 1e-10),
        points=np.array([0.3]),
        var_points=std_point[None] ** 2,
    )
    found = estimate(prior, Grid(nodes, [0.0]), [coil])
    assert found.solve.converged
    middle = found.at(0.25, 0.0)
    gap = truth.at([0.25]).pose[0, :3, 3] - middle.position
    assert gap @ np.linalg.solve(middle.cov_position_world, gap) < 25.0


@dataclass(frozen=True)
class Scripted:
    """An end of an iteration, of which only the cost and how it ended count."""

    cost: float
    outcome: Outcome
    iterations: int = 7
    first_step: float = 0.0
    state: None = None

    @property
    def located(self):
        return SimpleNamespace(parameters=SimpleNamespace(by_name=list))


def test_a_search_that_is_far_from_any_minimum_after_long_is_left_for_others(monkeypatch):
    monkeypatch.setattr(several_starts, "is_implausible", lambda prior, end, _=0: end.cost > 20.0)
    asked = []

    def solve(initial, options=None):
        asked.append((initial[0], options and options.max_iterations))
        lost = len(asked) == 1
        return Scripted(*((500.0, Outcome.ITERATION_LIMIT) if lost else (5.6, Outcome.CONVERGED)))

    sought = several_starts.StartProblem(
        robot(np.pi).prior, Grid([0.0, LENGTH], [0.0]), [], SolverOptions(), None
    )
    assert several_starts.best_end(sought, (None, []), solve)[0].cost == 5.6
    assert asked[0] == (None, 40)
    assert asked[1][0] is not None  # a bent shape, not the search's own end


@pytest.mark.parametrize(
    ("first", "other", "kept"),
    [
        ((5.6, Outcome.ITERATION_LIMIT), (58_640.0, Outcome.CONVERGED), 5.6),
        ((58_640.0, Outcome.CONVERGED), (5.6, Outcome.ITERATION_LIMIT), 5.6),
        ((9.0, Outcome.ITERATION_LIMIT), (5.6, Outcome.CONVERGED), 5.6),
        ((500.0, Outcome.ITERATION_LIMIT), (5.6, Outcome.CONVERGED), 5.6),
        ((500.0, Outcome.ITERATION_LIMIT), (300.0, Outcome.CONVERGED), 300.0),
        ((500.0, Outcome.CONVERGED), (300.0, Outcome.CONVERGED), 300.0),
    ],
)
def test_a_shape_whose_cost_is_plausible_is_kept_though_a_wrong_one_converges(
    monkeypatch, first, other, kept
):
    """As on rods whose strain may jump, where weights go to and fro with the shape."""
    monkeypatch.setattr(several_starts, "is_implausible", lambda prior, end, _=0: end.cost > 20.0)
    grid, ends = Grid([0.0, LENGTH], [0.0]), [Scripted(*first)]

    tries = []

    def solve(initial, options=None):
        tries.append(initial)
        return ends.pop() if ends else Scripted(*other)

    sought = several_starts.StartProblem(robot(np.pi).prior, grid, [], SolverOptions(), None)
    end, _ = several_starts.best_end(sought, (None, []), solve)
    assert end.cost == kept
    assert end.iterations == 7 * len(tries)
