"""Plans made beside the loop: the same plans, joined without a jump; late, dead or none at all."""

import pickle
import warnings
from dataclasses import replace
from time import thread_time

import numpy as np
import pytest

from glissando import FixedLagSmoother
from glissando.errors import GlissandoError, PlanWarning
from glissando.planning import PathSpace, ProcessPlanner, Replanner, Zone, belief_of, sliding_sensor
from glissando.planning.zones import read_zone
from plans import LENGTH, ROBOTS, SEPARABLE

REACH, SPEED, ACCELERATION = (0.3, LENGTH), 0.06, 0.3
ZONES = (Zone((0.35, 0.45)),)
WAIT = 60.0  # s, far more than any answer takes
kinds = pytest.mark.parametrize("kind", ROBOTS)


def replanner_of(robot=SEPARABLE, zones=ZONES, **given):
    track = PathSpace(*REACH, SPEED, ACCELERATION, 0.1, 30, LENGTH)
    return Replanner(sliding_sensor(robot), track, zones, node_step=0.5, **given)


def read_straight(sensor, path, since, until):
    """Readings that a straight robot gives on a path, at 40 Hz."""
    time = np.arange(since + 0.0125, until + 1e-9, 0.025)
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = path(time)
    return sensor.readings(pose, path(time), time)


def smoother_of(robot=SEPARABLE, until=1.0, path=lambda time: 0.7 - 0.05 * time):
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=9, gate=None)
    for time in np.arange(0.0, until + 1e-9, 0.5):
        smoother.add(read_straight(sliding_sensor(robot), path, time - 0.5, time))
        smoother.advance(time)
    return smoother


def update(replanner, smoother, times):
    for now in times:
        replanner.next(smoother, now)


class Slow:
    """Answers when it is told to."""

    def __init__(self):
        self.task, self.done, self.asked = None, False, 0

    def ask(self, task):
        self.task, self.done, self.asked = task, False, self.asked + 1

    def answer(self):
        return self.task() if self.done else None


@pytest.fixture(scope="module")
def elsewhere():
    with ProcessPlanner() as planner:
        yield planner


@kinds
def test_a_snapshot_of_a_smoother_is_that_of_its_posterior_and_small(kind):
    smoother = smoother_of(ROBOTS[kind])
    taken, other = belief_of(smoother), belief_of(smoother.posterior())
    assert len(pickle.dumps(taken)) < 9 * taken.cov.size + 10_000
    np.testing.assert_allclose(taken.cov, other.cov, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(taken.shape.pose, other.shape.pose)
    assert (taken.time, taken.before, taken.node_step) == (1.0, 0.5, 0.5)
    assert (other.time, other.before, other.node_step) == (1.0, 0.5, 0.5)


@pytest.mark.parametrize(("kind", "slack"), [("separable", 1e-3), ("kinematic", 0.06)])
def test_what_will_be_known_later_is_what_the_smoother_knows_then(kind, slack):
    robot = ROBOTS[kind]
    smoother = smoother_of(robot)
    later = belief_of(smoother).later(1.5, sliding_sensor(robot), lambda time: 0.7 - 0.05 * time)
    then = belief_of(smoother_of(robot, 1.5))
    assert (later.time, later.before) == (then.time, then.before)
    np.testing.assert_allclose(np.diag(later.cov), np.diag(then.cov), rtol=slack)


class Sink:
    """Takes tasks as another process would, and makes nothing of them."""

    def ask(self, task):
        self.parcel = pickle.dumps(task)

    def answer(self):
        return None


@kinds
def test_handing_over_takes_a_fraction_of_an_update(kind):
    robot, took = ROBOTS[kind], []
    smoother = smoother_of(robot)
    for time in np.arange(1.5, 11.0, 0.5):
        smoother.add(read_straight(sliding_sensor(robot), lambda t: 0.65 + 0 * t, time - 0.5, time))
        replanner, clock = replanner_of(robot, planner=Sink(), lead=0.5), [thread_time()]
        smoother.advance(time)
        clock.append(thread_time())
        replanner.next(smoother)
        took.append(np.diff([*clock, thread_time()]))
    update, handed = np.median(took, axis=0)
    assert handed < 0.15 * update


@kinds
def test_a_plan_made_elsewhere_is_the_one_made_here(kind, elsewhere):
    smoother = smoother_of(ROBOTS[kind])
    zones = [read_zone("0.5:0.6..0.3:0.4@0:9")]
    here = replanner_of(ROBOTS[kind], zones, lead=0.5)
    there = replanner_of(ROBOTS[kind], zones, lead=0.5, planner=elsewhere)
    there.next(smoother)
    assert elsewhere.ready(WAIT)
    plans = here.next(smoother), there.next(smoother)
    assert plans[0].start == plans[1].start == 1.5
    np.testing.assert_allclose(plans[0].control, plans[1].control, rtol=0, atol=1e-9)
    assert elsewhere.ready(WAIT)  # the next one, which it was asked for at once
    elsewhere.answer()


def test_what_elsewhere_cannot_plan_is_said_once_and_the_last_plan_goes_on(elsewhere):
    replanner = replanner_of(zones=[Zone((0.3, 0.4), (0.0, 1.0))], lead=0.5, planner=elsewhere)
    replanner.next(smoother_of(until=5.0))
    heard = []
    for _ in range(2):
        assert elsewhere.ready(WAIT)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert replanner.next(smoother_of(until=5.0)) is None
        heard += [str(warning.message) for warning in said]
    assert len(heard) == 1
    assert heard[0].startswith("No zone counts between 5.5 and 8.5 s")
    assert heard[0].endswith("the sensor stays where it is.")
    assert elsewhere.ready(WAIT)
    with pytest.raises(GlissandoError, match="No zone counts"):
        elsewhere.answer()


def test_zones_that_cannot_be_sent_are_refused_with_a_remedy(elsewhere):
    zone = Zone(lambda time: (0.3 + 0.0 * time, 0.4 + 0.0 * time))
    replanner = replanner_of(zones=[zone], planner=elsewhere)
    with pytest.raises(GlissandoError, match="functions at the top of a module"):
        replanner.next(smoother_of())


def test_a_planner_that_dies_leaves_the_last_plan_in_force_and_says_so_once():
    smoother = smoother_of()
    with ProcessPlanner() as planner:
        replanner = replanner_of(lead=0.5, planner=planner)
        replanner.next(smoother)
        assert planner.ready(WAIT)
        plan = replanner.next(smoother)
        planner.process.kill()
        planner.process.join(WAIT)
        assert planner.ready(WAIT)  # what it still said, or its end
        with pytest.warns(PlanWarning, match="process has ended; the last") as said:
            update(replanner, smoother, [1.1, 1.2, 1.3])
    assert len(said) == 1
    update(replanner, smoother, [3.0])
    place, speed = replanner.at(np.array([plan.start, 99.0]))
    assert place[0] == pytest.approx(LENGTH)
    assert REACH[0] <= place[1] <= REACH[1]
    assert speed[1] == pytest.approx(0.0, abs=1e-12)


def test_a_late_plan_is_not_taken_up_and_makes_the_next_begin_later():
    smoother, slow = smoother_of(), Slow()
    replanner = replanner_of(lead=0.3, planner=slow)
    slow.done = True
    replanner.next(smoother)
    slow.done = True
    first = replanner.next(smoother)
    before = replanner.at(np.linspace(0.0, 9.0, 91))
    assert replanner.next(smoother, 1.2) is first
    with pytest.warns(PlanWarning, match="was not there by then; the last one goes on"):
        assert replanner.next(smoother, 1.5) is first
    assert replanner.next(smoother, 1.6) is first  # said once
    slow.done = True
    assert replanner.next(smoother, 1.7) is first
    np.testing.assert_array_equal(before, replanner.at(np.linspace(0.0, 9.0, 91)))
    assert replanner.lead == pytest.approx(1.5 * (1.7 - 1.0))
    assert slow.task.start == pytest.approx(1.7 + replanner.lead)
    slow.done = True
    assert replanner.next(smoother, 1.8) is not first
    assert replanner.lead == 0.3  # it was there soon


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::glissando.errors.PlanWarning")
@kinds
def test_plans_that_come_when_they_may_join_without_a_jump_within_the_limits(kind):
    """Asked for and answered at odd times, with zones that the plans go after."""
    robot, slow, rng = ROBOTS[kind], Slow(), np.random.default_rng(0)
    zones = [Zone((0.6, 0.7), (0.0, 3.0)), Zone((0.3, 0.4), (3.0, 9.0))]
    replanner, smoother = replanner_of(robot, zones, lead=0.4, planner=slow), smoother_of(robot)
    now, plans, told = 1.0, set(), []
    while now < 7.0:
        slow.done = rng.random() < 0.6
        plans.add(id(replanner.next(replace(belief_of(smoother), time=now), now)))
        step = rng.uniform(0.05, 0.17)
        times = now + np.arange(0.0, step, 0.01)
        told.append([times, *replanner.at(times)])
        now += step
    time, place, speed = np.concatenate(told, axis=1)
    assert len(plans) > 4
    assert np.ptp(place) > 0.05
    assert REACH[0] - 1e-9 <= place.min()
    assert place.max() <= REACH[1] + 1e-9
    assert np.abs(speed).max() <= SPEED * (1 + 1e-6)
    step = np.diff(time)
    even = step > 1e-3
    assert np.abs(np.diff(speed)[even] / step[even]).max() <= ACCELERATION * (1 + 1e-5)
    np.testing.assert_allclose(np.diff(place), 0.5 * step * (speed[1:] + speed[:-1]), atol=2e-5)
