"""Robot files: length, rest strain, base, grid, prior and sensor noise, as validated TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import RobotFileError
from glissando.geometry.se3 import Array
from glissando.io.toml_table import Table, read_toml
from glissando.model.noise import GemanMcClure, Huber, Loss
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.priors.separable import BaseVariance, SeparablePrior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SIZES, SensorParameter
from glissando.model.sensors.sensors import sensor_class, sensor_kinds

_LOSSES: dict[str, type[Huber] | type[GemanMcClure]] = {
    "huber": Huber,
    "geman-mcclure": GemanMcClure,
}
_SHIPPED = Path(__file__).parent / "robots"


def shipped_robots() -> list[str]:
    """Names of the robots that come with the package."""
    return sorted(path.stem for path in _SHIPPED.glob("*.toml"))


def robot_file(name: str | Path) -> Path:
    """The file of a shipped robot by name, or of any robot by path. Raises RobotFileError."""
    if str(name) in shipped_robots():
        return _SHIPPED / f"{name}.toml"
    path = Path(name)
    if not path.exists():
        raise RobotFileError(
            f"There is no robot named {str(name)!r} and no such file; give a TOML file or one of "
            f"{', '.join(shipped_robots())}."
        )
    return path


def load_robot(name: str | Path) -> Robot:
    """A robot by the name of a shipped one or by the path of a robot file.

    Raises RobotFileError naming the file and the offending key.

    >>> load_robot("tdcr466").length
    0.466
    """
    return parse_robot(read_toml(robot_file(name), RobotFileError))


def parse_robot(table: Table) -> Robot:
    """The robot a TOML table describes."""
    name = table.text("name", Path(table.where).stem)
    length = table.number("length")
    prior = _prior(table)
    if prior.joints.size and prior.joints[-1] >= length:
        raise table.fail("[prior]", f"has a joint at {prior.joints[-1]:g} m, beyond the tip.")
    nodes, rate = _grid(table, length)
    nodes = np.sort(np.concatenate([nodes, _missing(prior.joints, nodes)]))
    sensors = _sensors(table)
    sensor_parameters = tuple(_unknown(entry) for entry in table.tables("unknowns"))
    table.skip("physics")  # of the simulator, which checks it
    table.close()
    return Robot(name, length, nodes, rate, prior, *sensors, sensor_parameters)


def _grid(table: Table, length: float) -> tuple[Array, float]:
    grid = table.table("grid", required=True)
    assert grid is not None
    rate = grid.number("time_rate")
    if isinstance(grid.peek("arclength_nodes"), list):
        nodes = grid.vector("arclength_nodes", len(grid.peek("arclength_nodes")))
        if nodes.size == 0 or nodes[0] != 0.0 or np.any(np.diff(nodes) <= 0.0):
            raise grid.fail("arclength_nodes", "must begin at 0 and increase.")
        if abs(nodes[-1] - length) > 1e-9:
            raise grid.fail(
                "arclength_nodes", f"ends at {nodes[-1]:g} m; end it at the length, {length:g} m."
            )
    else:
        count = grid.number("arclength_nodes")
        if count != int(count) or count < 2:
            raise grid.fail(
                "arclength_nodes",
                f"is {count:g}; give a whole number from 2 up, or the nodes themselves.",
            )
        nodes = np.linspace(0.0, length, int(count))
    grid.close()
    return nodes, rate


def _missing(joints: Array, nodes: Array) -> Array:
    """The joints that are no nodes yet."""
    return joints[[np.abs(nodes - joint).min() > 1e-9 for joint in joints]]


def _prior(table: Table) -> WhiteNoisePrior | SeparablePrior:
    """The prior, of the kind its table says, with the base it starts from."""
    prior = table.table("prior", required=True)
    assert prior is not None
    kind = prior.text("kind", choices=["kinematic", "separable"])
    joints, psd = _segments(prior)
    rest = _rest(table, kind, len(joints) + 1)
    common: dict[str, Any] = {"psd_strain_arclength": psd, **rest}
    if joints.size:
        name = "psd_jumps" if kind == "kinematic" else "var_jumps"
        common |= {"joints": joints, "jumps": prior.rows(name, joints.size, 6, positive=False)}
    base = table.table("base", required=kind == "separable")
    common["base_pose"] = base.pose() if base else np.eye(4)
    made: WhiteNoisePrior | SeparablePrior
    if kind == "separable":
        assert base is not None
        variances = (base.vector(f"var_{part}", 6, positive=True) for part in ("pose", "strain"))
        scale = prior.number("time_scale")
        made = SeparablePrior(time_scale=scale, base=BaseVariance(*variances), **common)
    else:
        parts = ("pose", "strain", "velocity")
        firm = [base.vector(f"psd_{part}", 6, positive=True) for part in parts] if base else None
        names = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
        common |= {name: prior.vector(name, 6, positive=True) for name in names}
        made = WhiteNoisePrior(base=BaseDensity(*firm) if firm else None, **common)
    if base:
        base.close()
    prior.close()
    return made


def _rest(table: Table, kind: str, segments: int) -> dict[str, Array]:
    """The rest strain, and its slope where it is given; of each segment, or (6,) of the body."""
    found = {}
    varies = isinstance(table.peek("rest_strain"), list) and any(
        isinstance(row, list) for row in table.peek("rest_strain")
    )
    if kind == "kinematic" and (varies or table.peek("rest_slope") is not None):
        raise table.fail(
            "rest_strain", 'varies along the body, which takes [prior] kind = "separable".'
        )
    for key in ("rest_strain", "rest_slope"):
        value = table.peek(key)
        if isinstance(value, list) and value and isinstance(value[0], list):
            found[key] = table.rows(key, segments, 6, positive=False, signed=True)
        elif key == "rest_strain" or value is not None:
            found[key] = table.vector(key, 6, STRAIGHT)
    return found


def _segments(prior: Table) -> tuple[Array, Array]:
    """Joints (S−1,), and strain densities (6,), or (S, 6) where there are joints."""
    if prior.peek("joints") is None:
        return np.zeros(0), prior.vector("psd_strain_arclength", 6, positive=True)
    joints = prior.numbers("joints")
    if np.any(np.diff(joints, prepend=0.0) <= 0.0):
        raise prior.fail("joints", "must increase from above 0.")
    return joints, prior.rows("psd_strain_arclength", joints.size + 1, 6)


def _unknown(table: Table) -> SensorParameter:
    """One [[unknowns]]: known, and held as it is, when it states no std."""
    name, kind = table.text("name"), table.text("kind", choices=SIZES)
    size = SIZES[kind]
    value = table.vector("value", size, np.zeros(size), pairs=False)
    std = table.vector("std", size, np.zeros(size), positive=True)
    drifts = table.peek("correlation_time") is not None
    memory = table.number("correlation_time") if drifts else np.inf
    streams = tuple(table.texts("streams"))
    table.close()
    return SensorParameter(name, kind, streams, value, std, memory)


def _sensors(
    table: Table,
) -> tuple[dict[str, Array], dict[str, Loss], dict[str, float], dict[str, float]]:
    """Standard deviations, losses, ranges and rates by kind of sensor."""
    std: dict[str, Array] = {}
    losses: dict[str, Loss] = {}
    ranges: dict[str, float] = {}
    rates: dict[str, float] = {}
    sensors = table.table("sensors")
    for kind in sensors.names() if sensors else []:
        assert sensors is not None
        if kind not in sensor_kinds():
            known = ", ".join(sensor_kinds())
            raise sensors.fail(kind, f"is not a kind of sensor; known: {known}.")
        sensor = sensors.table(kind, required=True)
        assert sensor is not None
        std[kind] = sensor.std(sensor_class(kind).rows)
        if sensor.peek("clip") is not None and not sensor_class(kind).tracker:
            ranges[kind] = sensor.number("clip")
        if sensor.peek("rate") is not None:
            rates[kind] = sensor.number("rate")
        name = sensor.text("loss", "none", choices=("none", *_LOSSES))
        if name != "none":
            loss = _LOSSES[name]
            losses[kind] = loss(sensor.number("threshold", loss().threshold))
        sensor.close()
    return std, losses, ranges, rates
