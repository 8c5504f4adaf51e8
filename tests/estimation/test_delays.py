"""A delay is known by the streams that do not have it, and by nothing else."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from glissando import FixedLagSmoother, PoseReadings, SensorParameter, estimate, load_robot
from glissando.evaluation.prior_predictive import PriorPredictive
from glissando.geometry import se3
from glissando.model.grid import Grid
from unknown_scenes import consistent

ROBOT = Path(__file__).parents[2] / "benchmarks" / "sbc.toml"
RATE, UNTIL, STD = 16.0, 1.5, 0.02
NOISE = np.repeat([1e-3, 1e-2], 3) ** 2
LATE = {"both": ("middle", "tip"), "tip": ("tip",), "middle": ("middle",)}


@cache
def scene(which):
    """The delay, and sessions of two trackers that have it or not, drawn from the prior."""
    robot = load_robot(str(ROBOT))
    late = SensorParameter("late", "time_offset", LATE[which], np.zeros(1), np.array([STD]))
    nodes = np.linspace(0.0, robot.length, 3)
    robot = replace(robot, sensor_parameters=(late,), arclength_nodes=nodes, time_rate=RATE)
    time = np.arange(0.1, UNTIL - 0.1, 1.0 / RATE)
    layout = [
        PoseReadings(
            time=time,
            arclength=np.full(time.size, place),
            values=np.tile(np.eye(4), (time.size, 1, 1)),
            cov=NOISE,
            name=name,
        )
        for name, place in (("middle", robot.length / 2), ("tip", robot.length))
    ]
    return late, PriorPredictive(robot, robot.grid(0.0, UNTIL), layout)


def estimated(which, seed, stated=STD, shift=0.0, *, online=False):
    """The delay that was drawn, the estimated one and its standard deviation."""
    late, predictive = scene(which)
    session = predictive.draw(np.random.default_rng(seed))
    readings = [r.changed(time=r.time + shift) for r in session.readings]
    late = replace(late, std=np.array([stated]))
    prior, grid = predictive.robot.prior, predictive.robot.grid(-0.3, UNTIL + 0.3)
    if online:
        posterior = heard(prior, grid, readings, late)
    else:
        posterior = estimate(prior, grid, readings, sensor_parameters=[late], gate=None)
    values, cov = posterior.parameter("late")
    middle = len(values) // 2
    return session.parameters[0, 0], values[middle, 0], np.sqrt(cov[middle, 0, 0])


def heard(prior, grid, readings, late):
    """The window at the end of a session that came in as it was measured, through a filter."""
    smoother = FixedLagSmoother(
        prior, grid.arclength, window=1, sensor_parameters=[late], gate=None
    )
    before = -np.inf
    for now in grid.time:
        for r in readings:
            new = (r.time > before) & (r.time <= now)
            if new.any():
                smoother.add(r.select(np.flatnonzero(new)))
        smoother.advance(now)
        before = now
    return smoother.posterior()


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.03, 0.12, 0.3])
def test_a_delay_longer_than_steps_or_the_window_is_known_no_better_than_it_is(delay):
    late = SensorParameter("late", "time_offset", ("tip",), np.array([delay]), np.array([0.01]))
    robot = load_robot("tdcr466-segments")
    prior, nodes = robot.prior, np.linspace(0.0, robot.length, 3)
    z = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        sway = rng.uniform(-1.0, 1.0, (2, 6)) * [0.05, 0.05, 0.05, 0.3, 0.3, 0.3]
        value = delay + 0.01 * rng.standard_normal()
        stated = replace(late, value=np.array([value]))
        smoother = FixedLagSmoother(prior, nodes, sensor_parameters=[stated], gate=None)
        for now in np.arange(0.0, 2.0, 0.05):
            for name, place, behind in (("middle", nodes[1], 0.0), ("tip", nodes[2], delay)):
                if now < behind + 0.05:
                    continue
                at = now - behind
                pose = prior.rest_state(Grid([0.0, place], [0.0])).pose[0, 1]
                moved = place / nodes[2] * (sway[0] * np.sin(4.0 * at) + sway[1] * np.cos(3.0 * at))
                noise = np.sqrt(NOISE) * rng.standard_normal(6)
                values = (pose @ se3.exp(moved) @ se3.exp(noise))[None]
                smoother.add(PoseReadings(
                    time=[now], arclength=[place], values=values, cov=NOISE, name=name
                ))  # fmt: skip
            smoother.advance(now)
        values, cov = smoother.posterior().parameter("late")
        z.append((values[-1, 0] - delay) / np.sqrt(cov[-1, 0, 0]))
    assert np.sqrt(np.mean(np.square(z))) < 2.5


@pytest.mark.slow
def test_a_delay_is_estimated_from_a_first_update_that_has_readings():
    late, predictive = scene("tip")
    session = predictive.draw(np.random.default_rng(0))
    prior, nodes = predictive.robot.prior, predictive.robot.arclength_nodes
    smoother = FixedLagSmoother(prior, nodes, sensor_parameters=[late])
    first = min(r.time[0] for r in session.readings)
    for r in session.readings:
        smoother.add(r.select(r.time <= first))
    smoother.advance(first)
    assert not smoother.dropped
    assert smoother.posterior().parameter("late")[1][-1, 0, 0] == pytest.approx(STD**2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "span", "online"),
    [("sliding700", 6.0, False), ("tdcr466-segments", 1.0, False), ("tdcr466-segments", 1.0, True)],
)
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_at_rest_tells_nothing_of_a_delay(name, span, online, seed):
    """What noise makes it seem to do would date readings to milliseconds."""
    robot, rng, streams = load_robot(name), np.random.default_rng(seed), []
    std = np.repeat([1e-3, 1e-2], 3)
    for label in "ab":
        time = np.arange(0.01, span, 0.025)
        straight = np.tile(np.eye(4), (time.size, 1, 1))
        straight[:, 2, 3] = robot.length
        noise = se3.exp(std * rng.standard_normal((time.size, 6)))
        place = np.full(time.size, robot.length)
        data = {"time": time, "arclength": place, "values": straight @ noise, "cov": std**2}
        streams.append(PoseReadings(**data, name=label))
    delay = SensorParameter("late", "time_offset", ("b",), [0.0], [0.05])
    grid = robot.grid(0.0, span)
    if online:
        found = heard(robot.prior, grid, streams, delay)
    else:
        found = estimate(robot.prior, grid, streams, sensor_parameters=[delay])
    value, cov = found.parameter("late")
    assert np.sqrt(cov[-1, 0, 0]) > 0.045
    assert abs(value[-1, 0]) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize(("stated", "shift"), [(0.02, 0.0), (0.2, 0.1)])
def test_a_delay_that_all_streams_share_stays_as_uncertain_as_before(stated, shift, online):
    _, value, std = estimated("both", 0, stated, shift, online=online)
    assert std == pytest.approx(stated, rel=0.1)
    assert abs(value) < stated


@pytest.mark.slow
@pytest.mark.parametrize(("which", "online"), [("tip", False), ("middle", False), ("tip", True)])
def test_a_delay_that_another_stream_shows_is_as_uncertain_as_stated(which, online):
    found = [estimated(which, seed, online=online) for seed in range(100, 114)]
    drawn, values, std = np.array(found).T
    squares = ((values - drawn) / std) ** 2
    assert np.median(std) < STD / 2.0
    assert std.max() < (0.7 if online else 0.5) * STD  # online, what has left the window counts
    assert consistent(squares, squares.size)
    assert not consistent(9.0 * squares, squares.size)


def bent(curvature, length, place):
    """The pose at a place of a robot of two segments with curvatures about x and y (4,)."""
    rest, half = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), length / 2
    first, second = (rest + np.array([0.0, 0.0, 0.0, *k, 0.0]) for k in np.split(curvature, 2))
    return se3.exp(min(place, half) * first) @ se3.exp(max(place - half, 0.0) * second)


@pytest.mark.slow
@pytest.mark.parametrize("online", [False, True])
def test_a_shape_that_bends_as_freely_as_it_may_dates_nothing(online):
    """The tip's readings fit best between the middle's whatever their delay is: 25 of 50 ms."""
    robot, z, std = load_robot("tdcr466-segments"), [], []
    nodes, time = np.linspace(0.0, robot.length, 3), np.arange(0.0, 2.0, 0.05)
    grid = Grid(nodes, np.arange(-0.3, 2.3, 0.05))
    delay, stated = 0.05, SensorParameter("late", "time_offset", ("tip",), [0.0], [0.05])
    for seed in range(4):
        rng = np.random.default_rng(seed)
        wide = rng.uniform(-1.5, 1.5, (2, 4))
        streams = []
        for name, place, late in (("middle", nodes[1], 0.0), ("tip", nodes[2], delay)):
            values = [
                bent(wide[0] * np.sin(3.0 * t) + wide[1] * np.cos(2.25 * t), nodes[2], place)
                @ se3.exp(np.sqrt(NOISE) * rng.standard_normal(6))
                for t in time - late
            ]
            at = np.full(time.size, place)
            streams.append(
                PoseReadings(time=time, arclength=at, values=values, cov=NOISE, name=name)
            )
        if online:
            found = heard(robot.prior, grid, streams, stated)
        else:
            found = estimate(robot.prior, grid, streams, sensor_parameters=[stated])
        value, cov = found.parameter("late")
        std.append(np.sqrt(cov[-1, 0, 0]))
        z.append((value[-1, 0] - delay) / std[-1])
    assert np.median(std) > 0.03
    assert np.sqrt(np.mean(np.square(z))) < 2.0


@pytest.mark.parametrize("seed", range(2))
def test_states_are_as_unsure_as_motion_makes_them_by_a_delay_that_nothing_dates(seed):
    """The second segment bends freely, so that the middle dates no reading of the tip."""
    robot, rng, sigma = load_robot("tdcr466-segments"), np.random.default_rng(seed), 0.03
    nodes, time = np.linspace(0.0, robot.length, 3), np.arange(0.0, 1.0, 1 / 30)
    bend, rates = rng.normal(0.0, 2.0, (2, 4)), rng.uniform(2.0, 4.0, 2)

    def pose(place, t):
        return bent(bend[0] * np.sin(rates[0] * t) + bend[1] * np.cos(rates[1] * t), 0.466, place)

    streams = []
    for name, place in (("middle", nodes[1]), ("tip", nodes[2])):
        noise = se3.exp(np.sqrt(NOISE) * rng.standard_normal((time.size, 6)))
        values = [pose(place, t) for t in time] @ noise
        streams.append(
            PoseReadings(time=time, arclength=place, values=values, cov=NOISE, name=name)
        )
    late = SensorParameter("late", "time_offset", ("tip",), [0.0], [sigma])
    grid = Grid(nodes, np.arange(-0.2, 1.2, 1 / 30))
    found = estimate(robot.prior, grid, streams, sensor_parameters=[late], gate=None)
    assert found.parameter("late")[1][-1, 0, 0] == pytest.approx(sigma**2, rel=0.05)
    for now in (0.3, 0.5, 0.7):
        moved = (pose(0.466, now + 0.01) - pose(0.466, now - 0.01))[:3, 3] / 0.02
        along, speed = moved / np.linalg.norm(moved), np.linalg.norm(moved)
        tip = found.at(0.466, now)
        std = np.sqrt(along @ tip.cov_position_world @ along)
        assert 0.6 * speed * sigma < std < 1.4 * speed * sigma + 0.005
        assert found.at(nodes[1], now).std_position < 0.005  # what is not late stays as it was read


def swaying(robot, time, place):
    """The pose at a place of an arc that sways."""
    bend = np.array([0.0, 0.0, 1.0, 1.5 * np.sin(1.9 * time), 0.0, 0.0])
    return se3.exp(place * bend)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdcr466-segments", "tdcr466"])
@pytest.mark.parametrize(
    ("delay", "std"), [(0.06, 0.005), (-0.06, 0.005), (0.15, 0.01), (0.05, 0.05)]
)
def test_a_live_loop_with_a_delay_starts_goes_on_and_outlives_a_pause(name, delay, std):
    """At first, and after a pause, delayed readings lie off the few nodes that there are."""
    robot, rng = load_robot(name), np.random.default_rng(0)
    late = SensorParameter("late", "time_offset", ("tip",), [0.0 if std > 0.02 else delay], [std])
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, sensor_parameters=[late])
    for now in np.r_[np.arange(1.0, 2.0, 1 / 30), np.arange(42.0, 43.0, 1 / 30)]:
        for stream, share, behind in (("middle", 0.5, 0.0), ("end", 1.0, 0.0), ("tip", 0.8, delay)):
            place = share * robot.length
            noise = se3.exp(np.sqrt(NOISE) * rng.standard_normal(6))
            values = (swaying(robot, now - behind, place) @ noise)[None]
            smoother.add(
                PoseReadings(time=[now], arclength=[place], values=values, cov=NOISE, name=stream)
            )
        smoother.advance(now)
    value, cov = smoother.posterior().parameter("late")
    assert abs(value[-1, 0] - delay) < 4.0 * np.sqrt(cov[-1, 0, 0])
    assert np.sqrt(cov[-1, 0, 0]) < 1.01 * std
