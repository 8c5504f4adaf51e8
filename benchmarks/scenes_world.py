"""Simulated tendon robot for `scenes.py`, with inertia and deviations from its robot file.

The rod has a permanent set and weight, tendons have friction and play, and stiffness, angles and
zeros differ from the file. The planner has only the total model error stated in [tendons].
"""

from dataclasses import dataclass, replace

import numpy as np

from glissando import CoilReadings
from glissando.errors import NoShapeError
from glissando.geometry import se3
from glissando.planning.scene.follow import MotionFollower
from glissando.simulation import Rod, Tendon
from glissando.simulation.dynamics import Scenario, simulate_motion
from glissando.simulation.imperfections import SmoothField

PAUSE = 0.5  # s between corrections
COMMANDS = 10  # tendon commands per pause
SET, SET_LENGTH = 0.35, 0.06  # rad/m, m
FRICTION, PLAY, ZERO, ANGLE, STIFFNESS = 0.03, 1e-4, 1e-4, 0.02, 0.03
MASS = 0.004  # kg/m
PLACES, MOMENTS = 25, 4  # points of the body, and times of a pause, tested for hits


@dataclass
class World:
    """Simulated robot: `pull` advances it, `read` simulates its sensor.

    `clearance` is the least distance to obstacles so far, m.
    """

    rod: Rod
    tendons: list
    stiffness: np.ndarray
    zero: np.ndarray
    scene: object
    rng: np.random.Generator
    time: float = 0.0
    motion: object = None
    reached: np.ndarray = None
    clearance: float = np.inf

    @staticmethod
    def drawn(robot, scene, seed):
        """Robot drawn by a seed."""
        rng, t = np.random.default_rng([seed, 7]), robot.tendons
        bent = SmoothField.draw(rng, 1, 2, SET_LENGTH)

        def rest(arclength):
            strain = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (arclength.size, 1))
            strain[:, 3:5] += SET * bent(arclength[:, None])
            return strain

        stiff = robot.mechanics.stiffness[0] * np.exp(STIFFNESS * rng.standard_normal())
        rotary = MASS * np.array([1.0, 1.0, 2.0]) * 1e-5
        rod = Rod(robot.length, stiff, rest, MASS, np.eye(4), rotary, retardation=0.03)
        angle = t.angle + ANGLE * rng.standard_normal(len(t))
        friction = FRICTION * rng.uniform()
        tendons = [
            Tendon(r * np.array([np.cos(a), np.sin(a)]), end, friction)
            for r, a, end in zip(t.radius, angle, t.end, strict=True)
        ]
        return World(rod, tendons, t.stiffness, ZERO * rng.standard_normal(len(t)), scene, rng)

    def pull(self, path):
        """Simulate PAUSE s while the tendons follow displacements (S, T) at equidistant times."""
        half, reached = 0.5 * PLAY, []
        at = path[0] if self.reached is None else self.reached
        for displacement in path:
            at = np.clip(at, displacement - half, displacement + half)
            reached.append(at + self.zero)
        even, pulls = np.linspace(0.0, PAUSE, len(path)), np.array(reached).T

        def pulled(time):
            return np.array([np.interp(time, even, row) for row in pulls])

        scenario = Scenario(
            displacements=pulled, tendon_stiffness=self.stiffness, gravity=(0.0, 0.0, -9.81)
        )
        before = self.motion
        begun = {} if before is None else {"mesh": before.mesh, "start": before.state[:2, -1]}
        self.motion = simulate_motion(
            self.rod, self.tendons, scenario, PAUSE, tolerance=1e-3, **begun
        )
        self.time, self.reached = self.time + PAUSE, at
        s = np.linspace(0.0, self.rod.length, PLACES)
        when = np.linspace(0.0, PAUSE, MOMENTS)[:, None]
        place = self.motion.at(s, when).pose[..., :3, 3].reshape(-1, 3)
        for obstacle in self.scene.obstacles:
            clear = float(obstacle.distance(place)[0].min()) - self.scene.robot_radius
            self.clearance = min(self.clearance, clear)

    def read(self, sensor, path):
        """Readings in the last PAUSE s of a sensor at arclengths (S,) at equidistant times."""
        count = max(1, round(sensor.rate * PAUSE))
        share = (np.arange(count) + 1.0) / count
        place = np.interp(share, np.linspace(0.0, 1.0, path.size), path)
        pose = self.motion.at(place, share * PAUSE).pose
        clean = sensor.readings(pose, place, self.time - PAUSE * (1.0 - share))
        std = np.sqrt(np.diagonal(clean.cov))
        noise = std * self.rng.standard_normal((count, std.size))
        if isinstance(clean, CoilReadings):  # coil noise is a right twist of the pose
            values = pose @ se3.exp(np.pad(noise, ((0, 0), (0, 1))))
        else:
            values = clean.values + noise
        return replace(clean, values=values)

    @property
    def tip(self):
        """Position of the tip (3,), m."""
        return self.motion.at(self.rod.length, PAUSE).pose[:3, 3]


@dataclass
class WanderingWorld(World):
    """Robot whose tendons' zeros drift with the standard deviation and time scale of its file."""

    std: float = 0.0
    kept: float = 1.0
    drift: np.random.Generator = None
    off: np.ndarray = None

    @staticmethod
    def drawn(robot, scene, seed):
        """Robot drawn by a seed."""
        plain = World.drawn(robot, scene, seed)
        drift = np.random.default_rng([seed, 11])
        std = robot.tendons.std
        return WanderingWorld(
            plain.rod, plain.tendons, plain.stiffness, plain.zero, scene, plain.rng,
            std=std, kept=float(np.exp(-PAUSE / robot.prior.time_scale)), drift=drift,
            off=std * drift.standard_normal(len(robot.tendons)),
        )  # fmt: skip

    def pull(self, path):
        """Simulate PAUSE s with drifting zeros, see `World.pull`."""
        rest = self.std * np.sqrt(1.0 - self.kept**2)
        new = self.kept * self.off + rest * self.drift.standard_normal(self.off.size)
        share = np.linspace(0.0, 1.0, len(path))[:, None]
        super().pull(path + (1.0 - share) * self.off + share * new)
        self.off = new


def run_loop(follower, world):
    """Follow a plan to its end; returns least clearance and the tip's miss, m."""
    problem = follower.problem
    count = len(problem.scene.tendons)
    for k in range(round(problem.scene.horizon / PAUSE) + 1):
        follower.command(k * PAUSE)
        path = follower.at(PAUSE * (k - np.linspace(1.0, 0.0, COMMANDS + 1)))
        world.pull(path[:, :count])
        if k == 0:  # at rest before the start
            world.time, world.clearance = 0.0, np.inf
        follower.advance(k * PAUSE)
        for slide, sensor in enumerate(problem.scene.sensors):
            follower.add(world.read(sensor, path[:, count + slide]))
    target = problem.scene.targets[-1]
    return world.clearance, float(np.linalg.norm(world.tip - target.position))


def followed(plan, robot, seed, kind=World):
    """Least clearance and miss (m) of a robot, drawn by a seed, that follows a plan."""
    world = kind.drawn(robot, plan.problem.scene, seed)
    try:
        return run_loop(MotionFollower(plan), world)
    except NoShapeError:
        return -1.0, np.inf
