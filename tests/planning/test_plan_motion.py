"""Planned motions: near the best, within limits and risk, or a sentence on what cannot be."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import GlissandoError
from glissando.planning.scene.mesh import read_mesh
from glissando.planning.scene.motion_search import Search
from glissando.planning.scene.motion_starts import reach_target, slide_ways, starts
from glissando.planning.scene.obstacles import HalfSpace, sphere
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.sampled_risk import sample_risk
from glissando.planning.scene.scene import Actuator, Target, Weights
from motion_scenes import ROBOT, SLIDE, TENDON, small_scene

BALL = sphere(np.array([0.02, 0.006, 0.205]), 0.006)


@pytest.fixture(scope="module")
def planned():
    """A plan past a ball."""
    scene = small_scene([BALL], target=(0.045, 0.012, 0.185))
    return plan_motion(motion_problem(scene, ROBOT), candidates=2, iterations=30)


@pytest.mark.slow
def test_a_plan_reaches_its_target_within_limits_at_the_risk_that_is_allowed(planned):
    scene = planned.problem.scene
    assert planned.miss <= scene.targets[0].tolerance
    assert planned.risk <= scene.delta + 2.0 * planned.risk_std
    time, values = planned.commands()
    step = time[1] - time[0]
    for actuator, column in zip([*scene.tendons, *scene.slides], values.T, strict=True):
        assert column.min() >= actuator.lower - 1e-9
        assert column.max() <= actuator.upper + 1e-9
        assert np.abs(np.diff(column)).max() <= actuator.speed * step * (1.0 + 1e-6)
        assert np.abs(np.diff(column, 2)).max() <= actuator.acceleration * step**2 * (1.0 + 1e-6)
        assert column[0] == pytest.approx(actuator.start)
        assert abs(column[-1] - column[-2]) < 1e-3 * actuator.speed


@pytest.mark.slow
def test_the_straight_way_would_not_have_kept_the_risk(planned):
    problem = planned.problem
    ends = planned.evaluation.values[-1]
    start = planned.evaluation.values[0]
    share = np.linspace(0.0, 1.0, problem.space.paths[0].steps + 2)
    straight = problem.space.follow(start[:, None] + np.outer(ends - start, share))
    assert problem.evaluate(straight).hits.value > 2.0 * problem.scene.delta


@pytest.mark.slow
def test_a_search_begins_on_both_sides_of_what_is_in_the_way():
    problem = motion_problem(small_scene([BALL], target=(0.045, 0.012, 0.185)), ROBOT)
    reaches = reach_target(problem, 0)[None]
    straight, *ways = (problem.evaluate(way) for way in starts(problem, reaches, 0))
    middle = len(straight.tip) // 2
    across = np.cross(straight.tip[-1] - straight.tip[0], straight.shapes.pose[middle, -1, :3, 2])
    across /= np.linalg.norm(across)
    aside = np.array([across @ (way.tip[middle] - straight.tip[middle]) for way in ways])
    for side in (aside, -aside):
        assert np.mean(side > BALL.radius + problem.scene.robot_radius) > 0.2


@pytest.mark.slow
def test_more_risk_costs_no_more(planned):
    scene = replace(planned.problem.scene, delta=0.3)
    looser = plan_motion(
        motion_problem(scene, ROBOT),
        warm_start=planned.evaluation.control,
        candidates=1,
    )
    assert looser.evaluation.cost <= planned.evaluation.cost * (1.0 + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"target": (0.3, 0.0, 0.1)}, r"out of reach: .* no nearer than 207 mm"),
        (
            {"obstacles": [sphere(np.array([0.0, 0.0, 0.15]), 0.01)]},
            r"starts in collision: .* 13.9 mm inside obstacle 1",
        ),
        (
            {"obstacles": [HalfSpace(np.array([-0.0045, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))]},
            r"Where it starts, .* probability of \d\d",
        ),
        (
            {"obstacles": [sphere(np.array([0.045, 0.012, 0.185]), 0.003)]},
            r"is -3 mm from obstacle 1: .* is \d.* mm inside",
        ),
    ],
)
def test_a_scene_that_is_impossible_says_which_part_and_by_how_much(fields, sentence):
    given = {"obstacles": [], "target": (0.045, 0.012, 0.185), **fields}
    problem = motion_problem(small_scene(**given), ROBOT)
    with pytest.raises(GlissandoError, match=sentence):
        plan_motion(problem, iterations=5, candidates=1)


@pytest.mark.slow
def test_a_motion_is_planned_past_a_mesh(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    pytest.importorskip("rtree", reason="rtree is not installed")
    trimesh.creation.box((0.02, 0.02, 0.02)).export(tmp_path / "box.stl")
    pose = np.eye(4)
    pose[:3, 3] = 0.0, -0.03, 0.16
    scene = small_scene([read_mesh(tmp_path / "box.stl", pose)])
    plan = plan_motion(motion_problem(scene, ROBOT), candidates=1, iterations=3)
    assert plan.risk <= scene.delta + 2.0 * plan.risk_std
    assert [len(part) for part in scene.obstacles[0].distance(np.zeros((0, 3)))] == [0, 0]


def lattice(problem, count, rounds):
    """Motions on a lattice over all limits, made finer about the best that keeps the bound."""
    space, delta = problem.space, problem.scene.delta
    rows, centre, width = space.polytope
    low, high = space.bounds
    best = np.inf
    for _ in range(rounds):
        for free in itertools.product(*np.linspace(low, high, count).T):
            if np.any(np.abs(rows @ free - centre) > width + 1e-9):
                continue
            at = problem.evaluate(space.control(np.array(free)))
            if problem.misses(at).max() > 1.0:
                continue
            yield at
            if at.cost < best and at.hits.value <= delta:
                best, middle = at.cost, np.array(free)
        reach = 1.5 * (high - low) / (count - 1)
        low, high = middle - reach, middle + reach


@pytest.mark.slow
@pytest.mark.parametrize("weights", [Weights(accuracy=0.3), Weights(time=0.0, wear=1.0)])
def test_a_plan_is_within_one_percent_of_the_best_of_all_motions(weights):
    held = Actuator(-1e-9, 1e-9, 2e-3, 4e-3, 0.0)
    tendons = [held, replace(TENDON, upper=6e-3, speed=4e-3), held, held, held, held]
    slide = replace(SLIDE, speed=0.2, acceleration=0.4)
    ball = sphere(np.array([-0.028, 0.042, 0.17]), 0.006)
    scene = small_scene([ball], weights=weights, tendons=tendons, slides=[slide])
    wished = motion_problem(scene, ROBOT).body.shapes(np.array([[0, 3e-3, 0, 0, 0, 0]]))
    scene = replace(scene, targets=[Target(wished.place[0, -1], 0.008, 4.0)])
    problem = motion_problem(scene, ROBOT, step=2.0)
    cost = problem.evaluate(plan_motion(problem, candidates=3).evaluation.control).cost
    found = list(lattice(Reduced(problem, np.array([1, 6])), 13, 3))
    costs = np.array([at.cost for at in found])
    assert costs.min() < 1.05 * cost  # fine enough to find one that is better
    better = [at for at in found if at.cost < 0.99 * cost]
    for at in sorted(better, key=lambda at: at.cost):
        assert sample_risk(problem, at)[0] > scene.delta


class Reduced:
    """A problem of which only some free numbers move."""

    def __init__(self, problem, moving):
        self.problem, self.moving, self.scene, self.space = problem, moving, problem.scene, self
        self.whole = problem.space
        self.rest = self.whole.free(
            self.whole.follow(np.array([[p.start] * (p.steps + 2) for p in self.whole.paths]))
        )
        self.size, self.paths = len(moving), self.whole.paths
        rows, centre, width = self.whole.polytope
        held = np.delete(np.arange(self.whole.size), moving)
        kept = np.any(rows[:, moving] != 0.0, axis=1)
        centre = centre - rows[:, held] @ self.rest[held]
        self.polytope = rows[kept][:, moving], centre[kept], width[kept]
        self.bounds = tuple(end[moving] for end in self.whole.bounds)

    def follow(self, target):
        return self.whole.follow(target)

    def free(self, control):
        return self.whole.free(control)[self.moving]

    def control(self, free):
        whole = self.rest.copy()
        whole[self.moving] = free
        return self.whole.control(whole)

    def evaluate(self, control):
        return self.problem.evaluate(control)

    def misses(self, at):
        return self.problem.misses(at)


def narrow_passage(rng):
    """A problem with two balls, one at each side of a motion's tip, and the motion (C, S+2)."""
    scene = small_scene([], horizon=6.0)
    free = motion_problem(scene, ROBOT)
    motion = starts(free, np.stack([reach_target(free, 0)]), 0)[0]
    at = free.evaluate(motion)
    moment, n = len(at.values) // 2, -1 - int(rng.integers(0, 3))
    place, tangent = at.shapes.place[:, n], at.shapes.pose[moment, n, :3, 2]
    across = np.cross(tangent, place[moment + 1] - place[moment - 1])
    across /= np.linalg.norm(across)
    away, off = 0.012 + rng.uniform(5e-4, 2e-3), rng.uniform(-3e-3, 3e-3)
    balls = [sphere(place[moment] + (off + side * away) * across, 0.008) for side in (-1.0, 1.0)]
    return motion_problem(replace(scene, obstacles=balls), ROBOT), motion


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6])
def test_a_search_from_a_motion_that_hits_finds_one_through_a_narrow_passage(seed):
    problem, motion = narrow_passage(np.random.default_rng(seed))
    search = Search(problem, 0.045)
    assert search.missed(search.at(motion))
    found = search.improve(motion, 20)
    assert found.hits.value < 1.05 * search.allowed
    assert np.all(problem.misses(found) < 1.0)


def test_ways_of_the_slides_keep_their_limits_and_the_tendons_paths():
    problem, motion = narrow_passage(np.random.default_rng(0))
    space, count = problem.space, len(problem.scene.tendons)
    rows, centre, width = space.polytope
    ways = slide_ways(problem, motion)
    assert len(ways) == 65
    for way in ways:
        assert np.all(np.abs(rows @ space.free(way) - centre) <= width + 1e-9)
        np.testing.assert_array_equal(way[:count], motion[:count])
