"""A control loop that knows the shape now, and how sure it is. Usage: control_loop.py [SECONDS]."""

import sys

import numpy as np

from glissando import CoilReadings, FixedLagSmoother, load_robot
from glissando.geometry import se3

robot = load_robot("tdcr466")
smoother = FixedLagSmoother(robot, robot.arclength_nodes, window=4)
rng, cov = np.random.default_rng(0), np.repeat([5e-7, 4e-5], [3, 2])


def read_coil(time):
    """Stands for the tracker: a coil that slides behind the tip of a bending arc."""
    place = robot.length - 0.03 * (1.0 - np.cos(time))
    pose = se3.exp(place * np.array([0, 0, 1, 0, 2 + np.sin(time), 0]))
    seen = pose @ se3.exp(np.append(rng.normal(0.0, np.sqrt(cov)), 0.0))
    return CoilReadings(name="coil", time=[time], arclength=[place], values=[seen], cov=cov)


for time in np.arange(0.0, float(sys.argv[1]) if len(sys.argv) > 1 else 2.0, 1 / 30):
    smoother.add(read_coil(time))
    tip = smoother.advance(time)
    x, y, z = 1e3 * tip.position[-1]
    sure = 1e3 * tip.std_position[-1]
    print(f"{time:5.2f} s: tip at {x:6.1f} {y:6.1f} {z:6.1f} mm, ± {sure:.1f} mm")
