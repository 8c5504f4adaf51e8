"""Checks of a scene for a robot; each mistake is reported as a sentence."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from glissando.errors import FalseConfidenceWarning, GlissandoError
from glissando.estimation.tendon_prediction import predict
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.planning.scene.scene import Scene

_ROUNDING = 1e-9
_LEAST_RISK = 1e-3  # least allowed risk, at which 4,000 samples contain a few hits
_OFTENEST = 0.01  # s, least time between two corrections
_STRETCHED = 1.2  # largest reach of a robot over its length
_PULLED = 0.02  # displacement of tendons over the robot's length, if none is stated
_NOTICED = 0.3  # neglected over counted standard deviation, from which a warning is given


def require_scene(scene: Scene, robot: Robot) -> None:
    """Raise for a scene that is invalid or does not fit a robot.

    Args:
        scene: The scene.
        robot: The robot.

    Raises:
        GlissandoError: The first mistake found.
    """
    for mistake in _mistakes(scene, robot):
        raise GlissandoError(mistake)


def idle_obstacles(scene: Scene, robot: Robot) -> Iterator[str]:
    """Yield a sentence for each obstacle out of the robot's reach, probably in another unit.

    Args:
        scene: The scene.
        robot: The robot.
    """
    base = _base(robot)[None]
    for number, obstacle in enumerate(scene.obstacles, start=1):
        away = float(obstacle.distance(base)[0][0]) - scene.robot_radius
        if away > _STRETCHED * robot.length:
            yield (
                f"Obstacle {number} is {away:.3g} m from the base of a robot of "
                f"{robot.length:.3g} m, which never comes there: are its numbers metres?"
            )


def unsure_numbers(robot: Robot) -> str:
    """Warning of the uncertainty of learned tendon parameters, which the risk neglects; or empty.

    Args:
        robot: The robot; its tip's uncertainty is compared with each tendon pulled alone as far as
            in learning.
    """
    tendons = robot.tendons
    if tendons is None or not (tendons.replicates or tendons.left_open):
        return ""
    reach = np.where(np.isfinite(tendons.learned_to), tendons.learned_to, _PULLED * robot.length)
    time, tip = np.arange(float(len(tendons))), np.array([robot.length])
    known_robot = replace(robot, tendons=replace(tendons, replicates=(), left_open=()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FalseConfidenceWarning)  # planning itself issues it
        std = [
            predict(each, time, np.diag(reach), tip).std_position for each in (robot, known_robot)
        ]
    total, counted = (float(np.sqrt(np.mean(each**2))) for each in std)
    omitted = float(np.sqrt(max(total**2 - counted**2, 0.0)))
    if omitted < _NOTICED * counted:
        return ""
    return (
        f"The risk leaves out how surely the numbers of [tendons] were learned: they leave the tip "
        f"unsure by {1e3 * omitted:.2g} mm, beside {1e3 * counted:.2g} mm that count, so hits may "
        f"be more frequent than is stated. Learn from more motions, or state a larger psd_moment."
    )


def _base(robot: Robot) -> Array:
    """Position (3,) of the base in the world, m."""
    pose: Array = getattr(robot.prior, "base_pose", np.eye(4))
    return pose[:3, 3]


def _mistakes(scene: Scene, robot: Robot) -> Iterator[str]:
    for name in ("robot_radius", "horizon", "correction"):
        if not getattr(scene, name) > 0.0:
            yield f"{name} of the scene is {getattr(scene, name)}; give a number above zero."
    if not _LEAST_RISK <= scene.delta < 1.0:
        yield (
            f"delta of the scene is {scene.delta:g}; give a probability from {_LEAST_RISK:g}, as "
            f"risks are sampled, to below 1: 0.05 for 5 %."
        )
    if not _OFTENEST <= scene.correction <= 0.5 * scene.horizon:
        yield (
            f"correction of the scene is {scene.correction:g} s within a horizon of "
            f"{scene.horizon:g} s; give seconds, from {_OFTENEST:g} to half of it."
        )
    count = 0 if robot.tendons is None else len(robot.tendons)
    if len(scene.tendons) != count:
        yield (
            f"The scene has limits of {len(scene.tendons)} tendons, and robot {robot.name!r} has "
            f"{count}; give an Actuator for each."
        )
    if len(scene.sensors) != len(scene.slides):
        yield (
            f"The scene has {len(scene.slides)} slides and {len(scene.sensors)} sensors; give what "
            f"slides on each."
        )
    yield from _mistakes_of_actuators(scene)
    yield from _mistakes_of_slides(scene, robot)
    yield from _mistakes_of_targets(scene)
    for number, zone in enumerate(scene.zones, start=1):
        if zone.center is not None:
            away = float(np.linalg.norm(zone.center - _base(robot)))
            short = away - zone.radius - robot.length
            if short > 0.0:
                yield (
                    f"Zone {number} at {zone.center.tolist()} m is {short:.3g} m out of "
                    f"reach of a robot of {robot.length:g} m; give metres, in the world frame."
                )


def _mistakes_of_actuators(scene: Scene) -> Iterator[str]:
    # numbered as in files: columns of tendons from tendon_0, tables [[slides]] from 1
    kinds = ("tendon", 0, scene.tendons), ("slide", 1, scene.slides)
    for name, number, a in ((n, k, a) for n, first, of in kinds for k, a in enumerate(of, first)):
        if not a.lower < a.upper:
            yield f"The limits of {name} {number} are {a.lower:g} and {a.upper:g} m; give a range."
        if not a.lower - _ROUNDING <= a.start <= a.upper + _ROUNDING:
            yield (
                f"{name.capitalize()} {number} starts at {a.start:g} m, and its limits are "
                f"{a.lower:g} and {a.upper:g} m; start between them."
            )
        if not (a.speed > 0.0 and a.acceleration > 0.0):
            yield (
                f"{name.capitalize()} {number} has a speed of {a.speed:g} m/s and an acceleration "
                f"of {a.acceleration:g} m/s²; give numbers above zero."
            )


def _mistakes_of_slides(scene: Scene, robot: Robot) -> Iterator[str]:
    for number, (slide, sensor) in enumerate(zip(scene.slides, scene.sensors, strict=False), 1):
        low, high = slide.lower - float(np.max(sensor.behind)), slide.upper
        if low < -_ROUNDING or high > robot.length + _ROUNDING:
            yield (
                f"Coils of slide {number} go from {low:g} to {high:g} m along a robot of "
                f"{robot.length:g} m; give limits on its body."
            )
        if sensor.arclength_std > 0.0:
            yield (
                f"The sensor of slide {number} has an arclength_std of {sensor.arclength_std:g} m, "
                f"and motions are planned for sensors whose place is known; give 0."
            )


def _mistakes_of_targets(scene: Scene) -> Iterator[str]:
    if not scene.targets:
        yield "The scene has no target; give one at least."
    for target in scene.targets:
        if np.shape(target.position) != (3,) or not np.all(np.isfinite(target.position)):
            yield f"The position of a target is {target.position!r}; give three numbers, m."
        if not 0.0 < target.time <= scene.horizon + _ROUNDING:
            yield (
                f"The time of a target is {target.time:g} s, and the motion lasts "
                f"{scene.horizon:g} s; give a time within it."
            )
    for a, b in pairwise(scene.targets):
        if b.time < a.time:
            yield (
                f"Targets are due at {a.time:g} s and then at {b.time:g} s; give them in the order "
                f"of time."
            )
        apart = float(np.linalg.norm(np.subtract(a.position, b.position)))
        if b.time == a.time and apart > a.tolerance + b.tolerance:
            yield (
                f"Two targets that are {1e3 * apart:.3g} mm apart are due at {a.time:g} s; give "
                f"them times of their own."
            )
