"""Small robots, planning problems and replanners that the tests of planning share."""

from dataclasses import replace

import numpy as np

from glissando import BaseVariance, FixedLagSmoother, SeparablePrior, load_robot
from glissando.planning import (
    Chance,
    LogDet,
    PathSpace,
    Replanner,
    Trace,
    Worst,
    Zone,
    path_objective_of,
    predict_information,
    sliding_sensor,
)

LENGTH = 0.7
KINEMATIC = replace(
    load_robot("sliding700"),
    arclength_nodes=np.linspace(0.0, LENGTH, 5),
    time_rate=2.0,
    sensor_parameters=(),
)
SEPARABLE = replace(
    KINEMATIC,
    prior=SeparablePrior(
        np.array([1e-4, 1e-4, 1e-4, 20, 20, 1.0]),
        2.0,
        BaseVariance(np.full(6, 1e-6), np.array([1e-4, 1e-4, 1e-4, 5, 5, 0.1])),
    ),
)
ROBOTS = {"kinematic": KINEMATIC, "separable": SEPARABLE}
OBJECTIVES = {"trace": Trace(), "logdet": LogDet(), "max": Worst(), "chance": Chance(0.02)}
REACH, LONG_REACH = (0.58, LENGTH), (0.3, LENGTH)
SPEED, ACCELERATION = 0.06, 0.3  # of a replanner's stage
ZONE = Zone((0.4, 0.5))


def small_problem(kind="separable", horizon=3.0, reach=REACH, source=None, **options):
    coils = {name: options.pop(name) for name in ("coils", "spacing") if name in options}
    sensor = sliding_sensor(ROBOTS[kind], **coils)
    return predict_information(source or ROBOTS[kind], reach, horizon, sensor, **options)


def small_space(problem, start=LENGTH, speed=0.06, acceleration=0.2, reach=REACH):
    return PathSpace(*reach, speed, acceleration, problem.step, problem.steps, start)


def small_task(kind="separable", zone=ZONE, objective=OBJECTIVES["trace"], **options):
    """A planning problem with its path space and the objective of a path."""
    problem = small_problem(kind, **options)
    return problem, small_space(problem), path_objective_of(problem, [zone], objective)


def wiggle(problem, reach=REACH):
    """Arclengths (T,) that come by most of the reach."""
    elapsed = problem.times - problem.start
    return reach[1] - (reach[1] - reach[0]) * (0.5 - 0.47 * np.cos(2.3 * elapsed + 0.2))


def replanner_of(robot, zones, **options):
    space = PathSpace(*LONG_REACH, SPEED, ACCELERATION, 0.1, 30, LENGTH)
    return Replanner(sliding_sensor(robot), space, zones, node_step=0.5, **options)


def read_straight(sensor, place, time):
    """Readings (M,) that a straight robot gives at arclengths (M,)."""
    pose = np.tile(np.eye(4), (time.size, 1, 1))
    pose[:, 2, 3] = place
    return sensor.readings(pose, place, time)


def read_between(sensor, path, since, until):
    """Readings of a straight robot on a path, at 40 Hz."""
    time = np.arange(since + 0.0125, until + 1e-9, 0.025)
    return read_straight(sensor, path(time), time)


def smoother_of(robot, until=1.0, path=lambda time: 0.7 - 0.05 * time):
    """A smoother of a straight robot that was read on a path, with a node every 0.5 s."""
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes, window=9, gate=None)
    for time in np.arange(0.0, until + 1e-9, 0.5):
        smoother.add(read_between(sliding_sensor(robot), path, time - 0.5, time))
        smoother.advance(time)
    return smoother


def require_limits(time, place, speed, slack):
    """Places and speeds (M,) at times (M,) keep a replanner's limits, and join without a jump."""
    assert LONG_REACH[0] - 1e-9 <= place.min()
    assert place.max() <= LONG_REACH[1] + 1e-9
    assert np.abs(speed).max() <= SPEED * (1 + 1e-6)
    step = np.diff(time)
    even = step > 1e-3
    assert np.abs(np.diff(speed)[even] / step[even]).max() <= ACCELERATION * (1 + 1e-5)
    np.testing.assert_allclose(np.diff(place), 0.5 * step * (speed[1:] + speed[:-1]), atol=slack)
