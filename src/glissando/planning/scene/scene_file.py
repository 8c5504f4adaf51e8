"""Reading of scene.toml, with errors for values that are missing or probably in another unit.

`require_scene` checks what holds for every scene, whether read from a file or not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.io.toml_table import read_toml
from glissando.model.robot import Robot
from glissando.model.table import Table
from glissando.model.tendons.tendons import Tendons
from glissando.planning.scene.mesh import read_mesh
from glissando.planning.scene.obstacles import (
    HalfSpace,
    Obstacle,
    RoundedBox,
    capsule,
    sphere,
)
from glissando.planning.scene.scene import Actuator, Scene, SpaceZone, Target, Weights
from glissando.planning.sliding_sensor import SlidingSensor, sliding_sensor

_FAR = 10.0  # m, beyond which a length is taken to be in another unit
_LIKELY = 2.0  # standard deviations of displacements reserved at the ends of strokes by default
_FAST, _SHARP = 1.0, 50.0  # m/s and m/s², beyond which the unit is taken to be another
_WIDE = 0.1  # m, the same for a robot's radius or a tolerance


def read_scene(path: Path, robot: Robot) -> Scene:
    """Read a scene from a file, for a robot with [tendons].

    Args:
        path: Path of scene.toml.
        robot: The robot, whose file states the noise of its sensors.

    Raises:
        GlissandoError: A value is missing, impossible, or probably in another unit.
    """
    table = read_toml(path, GlissandoError)
    if robot.tendons is None:
        raise GlissandoError(
            f"Robot {robot.name!r} has no [tendons]; add this table to plan its motion."
        )
    radius = _length(table, "robot_radius", _WIDE)
    delta = table.number("delta")
    horizon = table.number("horizon", 10.0)
    if horizon > 600.0:
        raise table.fail("horizon", f"is {horizon:g} s; give seconds, 600 at most.")
    model_std, correction = table.number("model_std", 2e-4), table.number("correction", 0.25)
    if model_std > radius:
        raise table.fail(
            "model_std", f"is {model_std:g} m on a robot of radius {radius:g} m; give metres, less "
            f"than that.",
        )  # fmt: skip
    obstacles = [_obstacle(entry, path.parent) for entry in table.tables("obstacles")]
    targets = [_target(entry, horizon, radius) for entry in table.tables("targets")]
    if not targets:
        raise table.fail("[[targets]]", "is missing; add one with a position.")
    targets.sort(key=lambda target: target.time)
    tendons, reserves = _tendons(table, robot.tendons, robot.length)
    slides, sensors = [], []
    for entry in table.tables("slides"):
        slide, sensor = _slide(entry, robot)
        slides.append(slide)
        sensors.append(sensor)
    zones = [_zone(entry, robot.length) for entry in table.tables("zones")]
    weights = _weights(table, zones)
    table.close()
    return Scene(
        obstacles, targets, radius, delta, horizon, tendons, slides, sensors, zones, weights,
        model_std, correction, *reserves,
    )  # fmt: skip


def _length(table: Table, key: str, most: float = _FAR, default: float | None = None) -> float:
    value = table.number(key, default)
    if value > most:
        raise table.fail(key, f"is {value:g} m; give metres, not millimetres.")
    return value


def _point(table: Table, key: str) -> Array:
    value = table.vector(key, 3)
    if np.abs(value).max() > _FAR:
        raise table.fail(key, f"is {value.tolist()} m; give metres, not millimetres.")
    return value


def _obstacle(table: Table, folder: Path) -> Obstacle:
    kind = table.text("kind", choices=("sphere", "capsule", "box", "half-space", "mesh"))
    made: Obstacle
    if kind == "sphere":
        made = sphere(_point(table, "center"), _length(table, "radius"))
    elif kind == "capsule":
        ends = _point(table, "start"), _point(table, "end")
        if np.array_equal(*ends):
            raise table.fail("end", f"is where it starts, {ends[0].tolist()} m; give a sphere.")
        made = capsule(*ends, _length(table, "radius"))
    elif kind == "half-space":
        point, normal = _point(table, "point"), table.vector("normal", 3)
        size = float(np.linalg.norm(normal))
        if size == 0.0:
            raise table.fail("normal", "has no length; give the direction out of the matter.")
        made = HalfSpace(point, normal / size)
    elif kind == "box":
        sizes, rounding = table.vector("size", 3, positive=True), 0.0
        if table.peek("rounding") is not None:
            rounding = _length(table, "rounding")
        if sizes.max() > _FAR or 2.0 * rounding > sizes.min():
            raise table.fail(
                "size", f"is {sizes.tolist()} m with a rounding of {rounding:g} m; give metres, "
                f"and a rounding of half the least size at most.",
            )  # fmt: skip
        made = RoundedBox(table.pose(), 0.5 * sizes - rounding, rounding)
    else:
        file = folder / table.text("file")
        made = read_mesh(file, table.pose(), table.number("scale", 1.0))
    table.close()
    return made


def _target(table: Table, horizon: float, radius: float) -> Target:
    tolerance = _length(table, "tolerance", _WIDE, radius)
    target = Target(_point(table, "position"), tolerance, table.number("time", horizon))
    table.close()
    return target


def _tendons(
    table: Table, made: Tendons, length: float
) -> tuple[list[Actuator], tuple[float, float]]:
    """Limits of the tendons, and the share of speed and part of strokes, m, for corrections."""
    count = len(made)
    limits = table.subtable("tendons")
    lower, upper, start = (_each(limits, key, count, default) for key, default in
                           (("lower", 0.0), ("upper", None), ("start", 0.0)))  # fmt: skip
    speed, acceleration = _quickness(limits)
    reserve = limits.number("reserve", 0.5, positive=False)
    if not 0.0 <= reserve < 1.0:
        raise limits.fail("reserve", f"is {reserve:g}; give a share of the speed, below 1.")
    if np.any(lower >= upper):
        raise limits.fail(
            "upper", f"is {upper.tolist()} m and lower {lower.tolist()} m; give a higher upper end."
        )
    likely = float(min(_LIKELY * np.max(made.std), 0.25 * np.min(upper - lower)))
    stroke = limits.number("stroke_reserve", max(likely, 0.0), positive=False)
    if not 0.0 <= 2.0 * stroke <= float(np.min(upper - lower)):
        raise limits.fail(
            "stroke_reserve", f"is {stroke:g} m at both ends of a stroke of "
            f"{np.min(upper - lower):g} m; give metres, less than half of it.",
        )  # fmt: skip
    limits.close()
    if max(np.abs(lower).max(), np.abs(upper).max()) > 0.2 * length:
        raise limits.fail(
            "upper", f"reaches {upper.max():g} m on a robot of {length:g} m; give metres of "
            f"displacement, not millimetres.",
        )  # fmt: skip
    return [
        Actuator(float(low), float(high), speed, acceleration, float(at))
        for low, high, at in zip(lower, upper, start, strict=True)
    ], (reserve, stroke)


def _each(table: Table, key: str, count: int, default: float | None) -> Array:
    """Array (count,) from a number for all tendons or a list with one for each."""
    if isinstance(table.peek(key), list):
        return table.vector(key, count, pairs=False)
    return np.full(count, table.number(key, default, positive=False))


def _quickness(table: Table) -> tuple[float, float]:
    """Largest speed, m/s, and acceleration, m/s²."""
    values = table.number("speed"), table.number("acceleration")
    for key, value, most in zip(("speed", "acceleration"), values, (_FAST, _SHARP), strict=True):
        if value > most:
            raise table.fail(key, f"is {value:g}; give metres and seconds, {most:g} at most.")
    return values


def _slide(table: Table, robot: Robot) -> tuple[Actuator, SlidingSensor]:
    kind = table.text("kind", "coil")
    name, rate = table.text("name", kind), table.number("rate", 40.0)
    sensor = sliding_sensor(robot, kind, rate=rate, name=name)
    reach = table.vector("reach", 2)
    if not 0.0 <= reach[0] < reach[1] <= robot.length + 1e-9:
        raise table.fail(
            "reach", f"is {reach.tolist()} m on a body of {robot.length:g} m; give two arclengths "
            f"on it, in metres, the lower first.",
        )  # fmt: skip
    start = table.number("start", float(reach[1]), positive=False)
    speed, acceleration = _quickness(table)
    table.close()
    return Actuator(float(reach[0]), float(reach[1]), speed, acceleration, start), sensor


def _zone(table: Table, length: float) -> SpaceZone:
    weight = table.number("weight", 1.0)
    if table.peek("arclength") is not None:
        low, high = table.vector("arclength", 2).tolist()
        table.close()
        if not 0.0 <= low <= high <= length + 1e-9:
            raise table.fail("arclength", f"is {[low, high]} m on a body of {length:g} m.")
        return SpaceZone(arclength=(low, high), weight=weight)
    zone = SpaceZone(_point(table, "center"), _length(table, "radius"), weight=weight)
    table.close()
    return zone


def _weights(table: Table, zones: list[SpaceZone]) -> Weights:
    """Weights of the cost terms; by default information has one only if there are zones."""
    given = table.table("weights")
    usual = Weights(information=1.0 if zones else 0.0)
    if given is None:
        return usual
    values = {name: given.number(name, default, positive=False)
              for name, default in vars(usual).items()}  # fmt: skip
    given.close()
    if min(values.values()) < 0.0:
        raise given.fail(
            min(values, key=lambda name: values[name]), "is below zero; give 0 or more."
        )
    if bool(values["information"]) != bool(zones):
        raise given.fail(
            "information", f"is {values['information']:g} with {len(zones)} [[zones]]; give both, "
            f"or neither.",
        )  # fmt: skip
    return Weights(**values)
