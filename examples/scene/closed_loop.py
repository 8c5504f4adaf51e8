"""A tendon robot with inertia, off its model, follows a plan that is made anew every second.

closed_loop.py [SEED]. The robot is simulated as a moving rod: tendons that do not start at zero, a
stiffness that is off by a few per cent, weight. Its coil reads it; what is read corrects the
commands and, every second, the plan of what is left.
"""

import sys
from pathlib import Path

import numpy as np

from glissando import CoilReadings, load_robot
from glissando.geometry import se3
from glissando.planning.scene.plan_motion import motion_problem, plan_motion
from glissando.planning.scene.replan_motion import MotionReplanner
from glissando.planning.scene.scene_file import read_scene
from glissando.simulation import Rod, Tendon
from glissando.simulation.dynamics import Scenario, simulate_motion

HERE = Path(__file__).parent


def real_robot(robot, rng):
    """The rod and the tendons of a robot that is not quite what its file says."""
    stiffness = robot.mechanics.stiffness[0] * np.exp(0.03 * rng.standard_normal())
    straight = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    inertia = 4e-8 * np.array([1.0, 1.0, 2.0])
    rod = Rod(robot.length, stiffness, straight, 4e-3, np.eye(4), inertia, retardation=0.03)
    known = robot.tendons
    angles = known.angle + 0.02 * rng.standard_normal(len(known))
    tendons = [
        Tendon(radius * np.array([np.cos(angle), np.sin(angle)]), end)
        for radius, angle, end in zip(known.radius, angles, known.end, strict=True)
    ]
    return rod, tendons, 1e-4 * rng.standard_normal(len(known))


class Robot:
    """The simulated robot: `pull` moves it on, and returns what the coil read meanwhile."""

    def __init__(self, robot, scene, rng):
        self.rod, self.tendons, self.zero = real_robot(robot, rng)
        self.stiffness, self.sensor = robot.tendons.stiffness, scene.sensors[0]
        self.rng, self.motion = rng, None

    def pull(self, time, path):
        """Follow displacements and the coil's arclengths (S, T+1) at times (S,)."""
        pause, first = time[-1] - time[0], time[0]
        rows = path[:, : self.zero.size].T + self.zero[:, None]

        def pulled(since):
            return np.array([np.interp(first + since, time, row) for row in rows])

        scenario = Scenario(
            displacements=pulled, tendon_stiffness=self.stiffness, gravity=(0.0, 0.0, -9.81)
        )
        before = self.motion
        begun = {} if before is None else {"mesh": before.mesh, "start": before.state[:2, -1]}
        self.motion = simulate_motion(
            self.rod, self.tendons, scenario, pause, tolerance=1e-3, **begun
        )
        when = np.linspace(0.1, 1.0, 10) * pause
        place = np.interp(first + when, time, path[:, -1])
        std = np.sqrt(np.append(self.sensor.cov, 0.0))
        noise = std * self.rng.standard_normal((when.size, 6))
        poses = self.motion.at(place, when).pose @ se3.exp(noise)
        return CoilReadings(
            time=first + when, arclength=place, values=poses, cov=self.sensor.cov, name="coil"
        )

    @property
    def tip(self):
        """Where the tip is now (3,), m."""
        return self.motion.at(self.rod.length, self.motion.time[-1]).pose[:3, 3]


def main():
    """Plan, and follow the plan to its end."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    robot = load_robot(HERE / "arm.toml")
    scene = read_scene(HERE / "scene.toml", robot)
    plan = plan_motion(motion_problem(scene, robot), candidates=1, iterations=15)
    print(f"Planned: {100 * plan.risk:.2g} % would hit, {100 * scene.delta:g} % are allowed.")
    real, replanner = Robot(robot, scene, np.random.default_rng(seed)), MotionReplanner(plan)
    for now in np.arange(0.0, scene.horizon + 1e-9, scene.correction):
        replanner.command(now)
        time = now - scene.correction * np.linspace(1.0, 0.0, 6)
        path = replanner.at(time)
        readings = real.pull(time, path)
        replanner.advance(now)
        replanner.add(readings)
        if abs(now - round(now)) < 1e-6:
            far = np.linalg.norm(real.tip - scene.targets[-1].position)
            print(
                f"{now:4.1f} s: tip {1e3 * far:5.1f} mm from its target, coil at "
                f"{1e3 * path[-1, -1]:3.0f} mm, planned anew {replanner.plans} times",
                flush=True,
            )
    if replanner.exceeded:
        print(replanner.exceeded)
    far = np.linalg.norm(real.tip - scene.targets[-1].position)
    print(replanner.stopped or f"It came to rest {1e3 * far:.1f} mm from its target.")


if __name__ == "__main__":
    main()
