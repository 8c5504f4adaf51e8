"""A sensor that goes where confidence is wanted, and one that oscillates. closed_loop.py [SECONDS].

A simulated robot bends from C to S while what matters moves from its tip to its middle.
"""

import sys

import numpy as np

from glissando import CoilReadings, FixedLagSmoother, load_robot
from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file
from glissando.planning import Replanner, Zone, path_space_of, sliding_sensor
from glissando.simulation import SlidePath, load_bench

robot, bench = load_robot("sliding700"), load_bench(robot_file("sliding700"))
lasts = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
motion = bench.move(bench.shape("C-to-S").lasting(lasts), bench.flaws, 0)
blind = SlidePath.oscillate(9, bench.full_slide.stroke, bench.full_slide)
zone = Zone(lambda time: (0.6 - 0.25 * time / lasts, 0.7 - 0.25 * time / lasts))
std = robot.sensor_std["coil"]
for name in ("planned", "oscillating"):
    rng, results = np.random.default_rng(0), []
    path_space = path_space_of(bench.full_slide, upper=0.7, start=0.7, horizon=5.0)
    replanner = Replanner(sliding_sensor(robot), path_space, [zone])
    smoother = FixedLagSmoother(robot, robot.arclength_nodes, window=6)
    for now in np.arange(0.0, lasts, 0.5):
        time = now + np.linspace(-0.475, 0.0, 20)[-20 if now else -1 :]
        place = replanner.at(time)[0] if name == "planned" else 0.7 - blind.at(time)
        noise = np.pad(std * rng.standard_normal((time.size, 5)), ((0, 0), (0, 1)))
        pose = motion.at(place, time).pose @ se3.exp(noise)
        smoother.add(CoilReadings(time=time, arclength=place, values=pose, cov=std**2, name="coil"))
        smoother.advance(now)
        if name == "planned":
            replanner.next(smoother)
        where, when = zone.points(np.array([now]))
        at, true = smoother.at(where, when), motion.at(where, when).pose[:, :3, 3]
        results.append([np.mean(at.std_position**2), np.mean(np.sum((at.position - true) ** 2, 1))])
    sigma, error = 1e3 * np.sqrt(np.mean(results[4:], axis=0))
    print(f"{name}: the zone is known to ± {sigma:.1f} mm, its error is {error:.1f} mm")
