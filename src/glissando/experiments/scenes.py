"""Scenes: a robot, a shape and a slide, simulated with a seed and estimated like any recording.

The prior of the robot file was tuned on the shapes of TUNED_ON and is tested on REPORTED_ON.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from glissando.errors import RobotFileError
from glissando.estimation.batch import estimate
from glissando.estimation.posterior import Posterior
from glissando.evaluation.metrics import Errors, errors_against
from glissando.experiments.published import RATE as PUBLISHED_RATE
from glissando.experiments.published import published_prior, published_readings
from glissando.io.recording import Recording
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file
from glissando.model.grid import Grid, with_places
from glissando.model.priors.prior import Prior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings
from glissando.simulation import (
    Actuation,
    Bench,
    Imperfections,
    Motion,
    SlideLimits,
    SlidePath,
    load_bench,
    simulate_session,
)
from glissando.simulation.dynamics import DynamicMotion
from glissando.simulation.dynamics.scenario_file import scenario_of
from glissando.simulation.simulated_session import COIL_RATE

ROBOT = "sliding700"
PAPER_RATE = 2.0
"""Time nodes a second with which the prior was tuned and the paper's claims are tested."""
TUNED_ON: dict[str, Sequence[Sequence[float]]] = {
    "soft C": [[7, 0]],
    "back half": [[0, 14]],
    "J": [[14, 7]],
    "strong S": [[5, 16]],
    "soft C to strong S": [[7, 0], [5, 16]],
}
"""Tendon tensions (N) of the shapes on which the prior was tuned, with seeds from 1000."""
REPORTED_ON = ("straight", "C", "S", "C-to-S")
"""Named shapes of the robot file, with seeds from 0, to which all published numbers refer."""
_STILL = 1e-2  # factor on the densities over time of the prior for a robot that holds still


@dataclass(frozen=True)
class Scene:
    """Settings of a simulation and its estimate, except the seed.

    Attributes:
        shape: A name of REPORTED_ON or TUNED_ON, or a shape file.
        slide: 'hold', 'oscillate' or 'traverse'.
        duration: Duration of the session, and of the motion if the shape moves, s.
        speed: Speed of the slide, m/s.
        at: Displacement of 'hold', m.
        stroke: Stroke of the other slides, m.
        cycles: Number of cycles, there and back, of the other slides.
        flaws: Names of fields of the imperfections with factors on them.
        still: Whether the estimator's prior is that of a robot that holds still.
        nodes: Number of arclength nodes; None for the robot file's nodes.
        time_rate: Time nodes a second; None for the robot file's rate.
        robot: Shipped robot or robot file that is simulated.
        prior: Robot file for the estimate; empty for `robot`.
        dynamic: Whether the simulated robot has inertia.
        paced: Whether the rate of time nodes and the prior's densities are scaled from the shape's
            own duration to `duration`.
        published: Parts of the published estimator that replace ours, of `published.PARTS`.
        judged: Largest arclength of truth streams that are compared with, m.
    """

    shape: str
    slide: str
    duration: float
    speed: float = 0.024
    at: float = 0.0
    stroke: float = 0.06
    cycles: int = 3
    flaws: tuple[tuple[str, float], ...] = ()
    still: bool = False
    nodes: int | None = None
    time_rate: float | None = None
    robot: str = ROBOT
    prior: str = ""
    dynamic: bool = False
    paced: bool = False
    published: tuple[str, ...] = ()
    judged: float = np.inf


@lru_cache(maxsize=8)
def bench(name: str = ROBOT) -> Bench:
    """Simulated robot and bench of a shipped robot or robot file."""
    return load_bench(robot_file(name))


@lru_cache(maxsize=8)
def robot(name: str = ROBOT) -> Robot:
    """Estimator's model of a shipped robot or robot file."""
    return load_robot(name)


def known_robot(scene: Scene) -> Robot:
    """Robot that a scene's estimator assumes."""
    return robot(scene.prior or scene.robot)


def flaws(scene: Scene) -> Imperfections:
    """Imperfections of the bench, scaled by the scene's factors."""
    out = bench(scene.robot).flaws
    for name, factor in scene.flaws:
        out = replace(out, **{name: factor * getattr(out, name)})
    return out


def motion(scene: Scene, seed: int) -> Motion | DynamicMotion:
    """Motion of a scene's robot, whose permanent set in curvature is drawn with the seed."""
    scaled = flaws(scene)
    if scaled.set_curvature == 0.0:
        seed = 0  # without a set the motion is the same for every seed
    curvature, length = scaled.set_curvature, scaled.set_length
    inertia = scene.dynamic
    return _motion(scene.robot, scene.shape, scene.duration, inertia, curvature, length, seed)


@lru_cache(maxsize=32)
def _motion(
    name: str,
    shape: str,
    duration: float,
    inertia: bool,
    curvature: float,
    length: float,
    seed: int,
) -> Motion | DynamicMotion:
    known = bench(name)
    if shape in TUNED_ON:
        tensions = np.array(TUNED_ON[shape], dtype=float)
        time = np.linspace(0.0, duration, len(tensions)) if len(tensions) > 1 else np.zeros(1)
        actuation = Actuation(time, tensions, known.gravity)
    else:
        actuation = known.shape(shape).lasting(duration)
    imperfections = replace(known.flaws, set_curvature=curvature, set_length=length)
    if inertia:
        return known.move_dynamically(scenario_of(actuation), imperfections, seed, duration)
    return known.move(actuation, imperfections, seed)


def path(scene: Scene) -> SlidePath:
    """Path of the slide; 'traverse' has an ideal stage, fast and as long as the robot."""
    known = bench(scene.robot)
    stage = known.slide
    if scene.slide == "hold":
        return SlidePath.hold(scene.at, scene.duration, known.full_slide)
    if scene.slide == "traverse":
        stage = SlideLimits(known.rod.length, scene.speed, 4.0 * scene.speed)
    return SlidePath.oscillate(scene.cycles, scene.stroke, stage, speed=scene.speed)


def recording(scene: Scene, seed: int) -> Recording:
    """Simulated recording of a scene, with the seed's robot and noise, in memory."""
    moved, slide, duration = motion(scene, seed), path(scene), scene.duration
    used = replace(bench(scene.robot), inertial=np.zeros(0))  # unused; a third of the time
    session = simulate_session(used, moved, slide, seed=seed, duration=duration, flaws=flaws(scene))
    return Recording.of(session.streams(), session.name, known_robot(scene))


@dataclass(frozen=True)
class Trial:
    """One estimate of a scene: readings, truth, posterior and errors against truth."""

    readings: list[Readings]
    truth: list[Readings]
    posterior: Posterior
    errors: list[Errors]


def trial(scene: Scene, seed: int, other: WhiteNoisePrior | None = None) -> Trial:
    """Simulate a scene with a seed, estimate it, and compare with motion capture.

    An `other` prior replaces that of the scene.
    """
    known = known_robot(scene)
    parameters, window = known.sensor_parameters, (0.0, scene.duration)
    if "noise" in scene.published:  # published noise is uncorrelated: no unknown parameters
        parameters = tuple(parameter for parameter in parameters if parameter.known)
    recorded = recording(scene, seed)
    used, judges = recorded.choose(None, None)
    readings, _ = recorded.readings(used, known, window)
    rest = known.prior.rest_state(Grid(known.arclength_nodes, [0.0])).take(0)
    readings = [published_readings(r, scene.published, rest) for r in readings]
    truth, _ = recorded.readings(judges, known, window, as_truth=True)
    truth = [corrected(t, parameters) for t in truth if t.arclength.max() <= scene.judged]
    nodes = grid(scene)
    known_parameters = [parameter for parameter in parameters if parameter.known]
    # late stamps may be from before the session
    corrected_readings = [corrected(r, known_parameters) for r in readings]
    inside = [nodes.contains(r.arclength, r.time) for r in corrected_readings]
    readings = [r.select(rows) for r, rows in zip(readings, inside, strict=True)]
    posterior = estimate(other or prior(scene), nodes, readings, sensor_parameters=parameters)
    return Trial(readings, truth, posterior, [errors_against(posterior, t) for t in truth])


def grid(scene: Scene) -> Grid:
    """Grid of the robot file over a scene, with the scene's own nodes and rate if it has any."""
    known = known_robot(scene)
    if scene.nodes is not None:
        nodes = np.linspace(0.0, known.length, scene.nodes)
        known = replace(known, arclength_nodes=with_places(nodes, known.prior.joints))
    rate = PUBLISHED_RATE if "prior" in scene.published else scene.time_rate
    if rate is not None:
        known = replace(known, time_rate=rate)
    rate = min(_speedup(scene) * known.time_rate, max(COIL_RATE, known.time_rate))
    return replace(known, time_rate=rate).grid(0.0, scene.duration)


def prior(scene: Scene) -> Prior:
    """Prior of the robot file, with its densities scaled for `still` and `paced` scenes.

    Raises RobotFileError for such a scene with a separable prior, which has a time scale instead.
    """
    known, pace = known_robot(scene).prior, _speedup(scene)
    if "prior" in scene.published:
        return published_prior(known)
    if not scene.still and pace == 1.0:
        return known
    if not isinstance(known, WhiteNoisePrior):
        raise RobotFileError(
            "A separable prior has a time_scale to say how still a robot is; leave still and paced "
            "out."
        )
    still = _STILL if scene.still else 1.0
    powers = {"psd_velocity_time": 3, "psd_strain_time": 1, "psd_velocity_arclength": 1}
    densities = {name: still * pace**k * getattr(known, name) for name, k in powers.items()}
    base = known.base
    if base is not None:
        base = BaseDensity(base.pose / pace, base.strain / pace, base.velocity * pace)
    firm = {name: getattr(known, name) / pace for name in ("psd_strain_arclength", "jumps")}
    return replace(known, **densities, **firm, base=base)


def _speedup(scene: Scene) -> float:
    """Factor by which a paced scene is faster than the shape's own motion; 1 for other scenes."""
    time = bench(scene.robot).shape(scene.shape).time if scene.paced else np.zeros(1)
    return float(np.ptp(time)) / scene.duration if time.size > 1 else 1.0
