"""Estimates of pose, strain and velocity of continuum robots, with covariance.

A Gaussian-process prior, continuous in arclength and time, and the readings of sensors determine a
posterior: pose, strain and velocity with their covariance at any arclength and time.

>>> import numpy as np
>>> from glissando import CoilReadings, load_robot, estimate, uniform_grid
>>> robot = load_robot("tdcr466")
>>> grid = uniform_grid(robot.length, nodes=5, start=0.0, stop=1.0, rate=10.0)
>>> tip = np.tile(np.eye(4), (11, 1, 1))
>>> tip[:, 2, 3] = 0.466
>>> coil = CoilReadings(time=np.linspace(0, 1, 11), arclength=0.466, values=tip,
...                     cov=[1e-6, 1e-6, 1e-6, 1e-4, 1e-4])
>>> posterior = estimate(robot, grid, [coil])
>>> at = posterior.at(arclength=[0.233, 0.466], time=0.5)
>>> bool(at.std_position[1] < at.std_position[0])  # smaller at the coil
True
"""

import lazy_loader as _lazy

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
