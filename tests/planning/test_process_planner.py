"""Plans made beside the loop: the same plans, joined without a jump; late, dead or none at all."""

import pickle
import warnings
from dataclasses import replace
from time import thread_time

import numpy as np
import pytest

from glissando.errors import GlissandoError, PlanWarning
from glissando.planning import MovingInterval, ProcessPlanner, Zone, sliding_sensor
from glissando.planning.belief import belief_of
from glissando.planning.planners import InlinePlanner
from plans import (
    LENGTH,
    LONG_REACH,
    ROBOTS,
    SEPARABLE,
    replanner_of,
    require_limits,
    smoother_of,
)

ZONES = [Zone((0.35, 0.45))]
WAIT = 60.0  # s, far more than any plan takes
kinds = pytest.mark.parametrize("kind", ROBOTS)


class Slow:
    """Takes tasks as another process would, and has a plan ready when `done` is set."""

    def submit(self, task):
        self.task, self.done = pickle.loads(pickle.dumps(task)), False

    def result(self):
        return self.task() if self.done else None


@pytest.fixture(scope="module")
def process():
    with ProcessPlanner() as planner:
        yield planner


@pytest.mark.slow
@kinds
def test_the_belief_of_a_smoother_is_that_of_its_posterior_and_small(kind):
    smoother = smoother_of(ROBOTS[kind])
    belief, other = belief_of(smoother), belief_of(smoother.posterior())
    assert len(pickle.dumps(belief)) < 9 * belief.cov.size + 10_000
    np.testing.assert_allclose(belief.cov, other.cov, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(belief.shape.pose, other.shape.pose)
    for each in (belief, other):
        assert (each.time, each.previous_time, each.node_step) == (1.0, 0.5, 0.5)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 1e-3), ("kinematic", 0.06)])
def test_a_belief_that_is_propagated_is_that_of_the_smoother_at_the_later_time(kind, slack):
    robot, sensor = ROBOTS[kind], sliding_sensor(ROBOTS[kind])
    propagated = belief_of(smoother_of(robot)).propagate(1.5, sensor, lambda t: 0.7 - 0.05 * t)
    later = belief_of(smoother_of(robot, 1.5))
    assert (propagated.time, propagated.previous_time) == (later.time, later.previous_time)
    np.testing.assert_allclose(np.diag(propagated.cov), np.diag(later.cov), rtol=slack)


def broken():
    """A plan whose numbers break down."""
    np.linalg.cholesky(-np.eye(2))


@pytest.mark.parametrize("inline", [True, False])
def test_a_plan_that_breaks_down_is_a_sentence_and_the_planner_goes_on(process, inline):
    planner = InlinePlanner() if inline else process
    for _ in range(2):
        planner.submit(broken)
        assert inline or planner.ready(WAIT)
        with pytest.raises(GlissandoError, match="A plan broke down"):
            planner.result()


@pytest.mark.slow
@kinds
def test_submitting_a_task_takes_a_fraction_of_planning_it(kind):
    """What it takes beside an update is measured by benchmarks/plan.py."""
    smoother, durations = smoother_of(ROBOTS[kind]), []
    inline = replanner_of(ROBOTS[kind], ZONES, lead=0.5)
    for _ in range(3):
        beside, clock = replanner_of(ROBOTS[kind], ZONES, planner=Slow(), lead=0.5), [thread_time()]
        beside.next(smoother)
        clock.append(thread_time())
        inline.next(smoother)
        durations.append(np.diff([*clock, thread_time()]))
    submission, planning = np.min(durations, axis=0)
    assert submission < 0.15 * planning


@pytest.mark.slow
@kinds
def test_a_plan_computed_by_a_process_is_the_one_computed_inline(kind, process):
    smoother = smoother_of(ROBOTS[kind])
    zones = [Zone(MovingInterval((0.0, 9.0), (0.5, 0.6), (0.3, 0.4)), (0.0, 9.0))]
    inline = replanner_of(ROBOTS[kind], zones, lead=0.5)
    beside = replanner_of(ROBOTS[kind], zones, lead=0.5, planner=process)
    beside.next(smoother)
    assert process.ready(WAIT)
    plans = inline.next(smoother), beside.next(smoother)
    assert plans[0].start == plans[1].start == 1.5
    np.testing.assert_allclose(plans[0].control, plans[1].control, rtol=0, atol=1e-9)
    assert process.ready(WAIT)  # the next plan, for which a task was submitted at once
    process.result()


@pytest.mark.slow
def test_what_a_process_cannot_plan_is_reported_once_and_the_last_plan_goes_on(process):
    zones, smoother = [Zone((0.3, 0.4), (0.0, 1.0))], smoother_of(SEPARABLE, 5.0)
    replanner = replanner_of(SEPARABLE, zones, lead=0.5, planner=process)
    replanner.next(smoother)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(2):
            assert process.ready(WAIT)
            assert replanner.next(smoother) is None
    assert replanner.at(7.0)[0] == LENGTH
    (warning,) = caught
    assert str(warning.message).startswith("No zone counts between 5.5 and 8.5 s")
    assert str(warning.message).endswith("the sensor stays where it is.")
    assert process.ready(WAIT)
    with pytest.raises(GlissandoError, match="No zone counts"):
        process.result()


def test_zones_that_cannot_be_sent_are_refused_with_a_remedy(process):
    zone = Zone(lambda time: (0.3 + 0.0 * time, 0.4 + 0.0 * time))
    replanner = replanner_of(SEPARABLE, [zone], planner=process)
    with pytest.raises(GlissandoError, match="functions at the top of a module"):
        replanner.next(smoother_of(SEPARABLE))


@pytest.mark.slow
def test_a_planner_that_dies_leaves_the_last_plan_in_force_which_ends_at_rest():
    smoother = smoother_of(SEPARABLE)
    with ProcessPlanner() as planner:
        replanner = replanner_of(SEPARABLE, ZONES, lead=0.5, planner=planner)
        replanner.next(smoother)
        assert planner.ready(WAIT)
        plan = replanner.next(smoother)
        planner.process.kill()
        planner.process.join(WAIT)
        assert planner.ready(WAIT)  # for what it still sent, or its end
        with pytest.warns(PlanWarning, match="process has ended; the last") as caught:
            assert all(replanner.next(smoother, now) is plan for now in (1.1, 1.2, 1.3))
    assert len(caught) == 1
    replanner.next(smoother, 3.0)
    place, speed = replanner.at(plan.start + np.array([0.0, 3.0, 99.0]))
    assert place[0] == pytest.approx(LENGTH)
    assert LONG_REACH[0] <= place[1] == place[2] <= LONG_REACH[1]
    assert speed[1:] == pytest.approx(0.0, abs=1e-12)


def test_a_late_plan_is_not_adopted_and_makes_the_next_begin_later():
    smoother, slow = smoother_of(SEPARABLE), Slow()
    replanner = replanner_of(SEPARABLE, ZONES, lead=0.3, planner=slow)
    replanner.next(smoother)
    slow.done = True
    first = replanner.next(smoother)
    before = replanner.at(np.linspace(0.0, 9.0, 91))
    assert replanner.next(smoother, 1.2) is first
    with pytest.warns(PlanWarning, match="was not there by then; the last one goes on"):
        assert replanner.next(smoother, 1.5) is first
    assert replanner.next(smoother, 1.6) is first  # without another warning
    slow.done = True
    assert replanner.next(smoother, 1.7) is first
    np.testing.assert_array_equal(before, replanner.at(np.linspace(0.0, 9.0, 91)))
    assert replanner.lead == pytest.approx(1.5 * (1.7 - 1.0))
    assert slow.task().start == pytest.approx(1.7 + replanner.lead)
    slow.done = True
    assert replanner.next(smoother, 1.8) is not first
    assert replanner.lead == 0.3  # as it came soon


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::glissando.errors.PlanWarning")
@kinds
def test_plans_that_come_when_they_may_join_without_a_jump_within_the_limits(kind):
    """Submitted and ready at odd times, with zones that the plans go after."""
    robot, slow, rng = ROBOTS[kind], Slow(), np.random.default_rng(0)
    zones = [Zone((0.6, 0.7), (0.0, 3.0)), Zone((0.3, 0.4), (3.0, 9.0))]
    replanner, smoother = replanner_of(robot, zones, lead=0.4, planner=slow), smoother_of(robot)
    now, plans, out = 1.0, set(), []
    while now < 7.0:
        slow.done = rng.random() < 0.6
        plans.add(id(replanner.next(replace(belief_of(smoother), time=now), now)))
        step = rng.uniform(0.05, 0.17)
        times = now + np.arange(0.0, step, 0.01)
        out.append([times, *replanner.at(times)])
        now += step
    time, place, speed = np.concatenate(out, axis=1)
    assert len(plans) > 4
    assert np.ptp(place) > 0.05
    require_limits(time, place, speed, slack=2e-5)
