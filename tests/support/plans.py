"""Small robots, outlooks and tracks that the tests of planning share."""

from dataclasses import replace

import numpy as np

from glissando import BaseVariance, SeparablePrior, load_robot
from glissando.planning import PathSpace, Zone, predict_information, sliding_sensor

LENGTH = 0.7
KINEMATIC = replace(load_robot("sliding700"), arclength_nodes=np.linspace(0.0, LENGTH, 5))
SEPARABLE = replace(
    KINEMATIC,
    prior=SeparablePrior(
        np.array([1e-4, 1e-4, 1e-4, 20, 20, 1.0]),
        2.0,
        BaseVariance(np.full(6, 1e-6), np.array([1e-4, 1e-4, 1e-4, 5, 5, 0.1])),
    ),
)
ROBOTS = {"kinematic": KINEMATIC, "separable": SEPARABLE}
REACH = (0.58, LENGTH)
ZONE = Zone((0.4, 0.5))


def small_outlook(kind="separable", horizon=3.0, reach=REACH, known=None, **given):
    robot = ROBOTS[kind]
    sensor = sliding_sensor(robot, **{k: given.pop(k) for k in ("coils", "spacing") if k in given})
    return predict_information(robot if known is None else known, reach, horizon, sensor, **given)


def small_track(outlook, start=LENGTH, speed=0.06, acceleration=0.2, reach=REACH):
    return PathSpace(*reach, speed, acceleration, outlook.step, outlook.steps, start)


def wiggle(outlook, reach=REACH):
    """Arclengths (T,) that come by most of the reach."""
    into = outlook.times - outlook.start
    return reach[1] - (reach[1] - reach[0]) * (0.5 - 0.47 * np.cos(2.3 * into + 0.2))
