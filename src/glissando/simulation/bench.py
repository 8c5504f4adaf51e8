"""The [physics] table of a robot file: rod, tendons, stage, tracker, and named shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.io.toml_table import read_toml
from glissando.model.mechanics import strange_gravity
from glissando.model.slide_path import SlideLimits
from glissando.model.table import Table
from glissando.simulation.actuation import Actuation, read_actuation
from glissando.simulation.dynamics.integrate import simulate_motion
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.dynamics.scenario import Scenario
from glissando.simulation.dynamics.scenario_file import read_scenario, scenario_of
from glissando.simulation.imperfections import ROLLS, Imperfections, SmoothField
from glissando.simulation.motion import Motion, solve_motion
from glissando.simulation.rod import STRAIGHT, Rod, Tendon

_FRAME = 0.2  # s between solved shapes of a moving robot
_FEWEST, _MOST = 10, 20_000  # shapes between two times of an actuation


@dataclass(frozen=True)
class Bench:
    """Simulated robot with its sensors on a bench.

    Attributes:
        rod: Rod with the stiffness and mass of tubes and disks.
        tendons: Tendons of the robot.
        gravity: Gravity (3,) in the world frame, m/s².
        slide: Limits of the stage that slides the coil.
        full_slide: Limits of a stage as long as the robot, which exists in simulation only.
        coil_offset: Arclength of the coil minus the robot's length at displacement zero, m; ≤ 0.
        tracker: Pose T_wt (4, 4) of the tracker.
        flaws: Imperfections of robot and sensors.
        truth: Arclengths of the motion capture frames (C,), m.
        shapes: Actuations by name.
        inertial: Arclengths of gyroscopes with accelerometers (I,), m.
    """

    rod: Rod
    tendons: tuple[Tendon, ...]
    gravity: Array
    slide: SlideLimits
    full_slide: SlideLimits
    coil_offset: float
    tracker: Array
    flaws: Imperfections
    truth: Array
    shapes: dict[str, Actuation]
    inertial: Array

    def shape(self, name: str) -> Actuation:
        """Actuation by the name of a shape of the robot file, or by the path of a TOML file.

        Raises SimulationError if there is neither.
        """
        if name in self.shapes:
            return self.shapes[name]
        return read_actuation(self._file(name), len(self.tendons), self.gravity)

    def scenario(self, name: str) -> tuple[Scenario, float]:
        """Scenario of a named shape or of a TOML file, and its last time, s.

        Raises SimulationError if there is neither.
        """
        if name in self.shapes:
            return scenario_of(self.shapes[name]), float(self.shapes[name].time[-1])
        table = self._file(name)
        return read_scenario(table, len(self.tendons), self.gravity, self.rod.base)

    def _file(self, name: str) -> Table:
        path = Path(name)
        if not isfile(path):
            raise SimulationError(
                f"There is no shape named {name!r} and no such file; give a TOML file with "
                f"tensions, or one of {', '.join(self.shapes)}."
            )
        return read_toml(path, SimulationError)

    def move(self, actuation: Actuation, flaws: Imperfections, seed: int) -> Motion:
        """Quasi-static motion under an actuation; `seed` draws the robot's permanent set.

        Raises SimulationError for a motion that is too long, NoShapeError if the rod buckles.
        """
        rod = self._with_set(flaws, seed)
        frames = [actuation.time[:1]]
        for start, stop in pairwise(actuation.time):
            count = max(_FEWEST, np.ceil((stop - start) / _FRAME))
            if count > _MOST:
                raise SimulationError(
                    f"A motion of {stop - start:g} s would be {count:,.0f} shapes; give its times "
                    f"in seconds, {_MOST * _FRAME:g} s at most between two."
                )
            frames.append(np.linspace(start, stop, int(count) + 1)[1:])
        times = np.concatenate(frames)
        return solve_motion(rod, self.tendons, actuation.loads_at, times, actuation.time)

    def move_dynamically(
        self, scenario: Scenario, flaws: Imperfections, seed: int, duration: float
    ) -> DynamicMotion:
        """Motion with inertia over `duration` s; `seed` draws the robot's permanent set.

        Raises SimulationError for an impossible scenario, NoShapeError if the integration fails.
        """
        rod = self._with_set(flaws, seed)
        return simulate_motion(rod, self.tendons, scenario, duration)

    def _with_set(self, flaws: Imperfections, seed: int) -> Rod:
        """Rod with a random permanent set: curvature of the unloaded tubes."""
        rod = self.rod
        if flaws.set_curvature > 0.0:
            rng = np.random.default_rng([seed, 1])
            curvature = SmoothField.draw(rng, 1, 2, flaws.set_length)

            def rest(arclength: Array) -> Array:
                strain = np.array(self.rod.rest(arclength))
                strain[:, 3:5] += flaws.set_curvature * curvature(arclength[:, None])
                return strain

            rod = replace(rod, rest_strain=rest)
        return rod


def load_bench(path: Path) -> Bench:
    """Read the bench of a robot file's [physics]. Raises SimulationError if there is none."""
    table = read_toml(path, SimulationError)
    physics, base = table.table("physics"), table.table("base")
    if physics is None:
        raise SimulationError(
            f"{path.name} has no [physics]: it can be estimated, not simulated. Add its tubes, "
            f"tendons and stage, as `glissando robot new --physics` writes them, or choose another "
            f"robot."
        )
    length, rest = table.number("length"), table.vector("rest_strain", 6, STRAIGHT)
    return _bench(physics, length, rest, base.pose() if base else np.eye(4))


def _bench(table: Table, length: float, rest_strain: Array, base: Array) -> Bench:
    gravity = table.vector("gravity", 3, np.zeros(3))
    if strange := strange_gravity(gravity):
        raise table.fail("gravity", strange)
    rod = _rod(table, length, rest_strain, base)
    radius = table.number("disk_radius")
    tendons = tuple(_tendon(entry, rod, radius) for entry in table.tables("tendons"))
    slide, offset = _stage(table, "slide")
    full_slide, _ = _stage(table, "full_slide")
    mount = table.subtable("tracker")
    tracker = mount.pose()
    mount.close()
    listed = table.table("imperfections")
    flaws = _imperfections(listed) if listed else Imperfections()
    places = _places(table, "truth_arclengths", length)
    inertial = np.zeros(0)
    if table.peek("inertial_arclengths") is not None:
        inertial = _places(table, "inertial_arclengths", length)
    if not 0.0 <= length + offset <= length:
        raise table.fail("coil_offset", f"is {offset:g} m, off the robot; give −{length:g} to 0.")
    shapes = {}
    if (entries := table.table("shapes")) is not None:
        for name in entries.names():
            entry = entries.subtable(name)
            shapes[name] = read_actuation(entry, len(tendons), gravity)
    table.close()
    stages = slide, full_slide, offset
    return Bench(rod, tendons, gravity, *stages, tracker, flaws, places, shapes, inertial)


def _places(table: Table, key: str, length: float) -> Array:
    listed = table.peek(key)
    if not isinstance(listed, list) or not listed:
        raise table.fail(key, f"is {listed!r}; give a list of places in metres.")
    places = table.vector(key, len(listed), pairs=False)
    if np.any(places < 0.0) or np.any(places > length) or np.unique(places).size < places.size:
        raise table.fail(key, f"is {listed}; give each place once, 0 to {length:g} m.")
    return places


def _rod(table: Table, length: float, rest_strain: Array, base: Array) -> Rod:
    tubes = []
    for entry in table.tables("tubes"):
        outer, inner = entry.number("outer"), entry.number("inner", 0.0, positive=False)
        tubes.append((outer, inner))
        entry.close()
    if not tubes:
        raise table.fail("[[tubes]]", "is missing; add one with outer and inner diameters in m.")
    young, density = table.number("young"), table.number("density")
    rod = Rod.of_tubes(
        length,
        tubes,
        young=young,
        poisson=table.number("poisson", positive=False),
        density=density,
        rest_strain=rest_strain,
        base=base,
        retardation=table.number("retardation", 0.0, positive=False),
        air_damping=table.number("air_damping", 0.0, positive=False),
    )
    if rod.retardation > 1.0:
        raise table.fail("retardation", f"is {rod.retardation:g} s; give seconds, 1 at most.")
    disks, radius = (
        table.number("disk_mass_per_length", 0.0, positive=False),
        table.peek("disk_radius"),
    )
    turning = disks * float(radius or 0.0) ** 2 * np.array([0.25, 0.25, 0.5])
    mass, rotary = rod.mass_per_length + disks, rod.rotary_inertia + turning
    return replace(rod, mass_per_length=mass, rotary_inertia=rotary)


def _tendon(table: Table, rod: Rod, disk_radius: float) -> Tendon:
    end, friction = table.number("end"), table.number("friction", 0.0, positive=False)
    if table.peek("pitch") is not None:
        radius, angle = table.number("radius"), table.number("angle", 0.0, positive=False)
        tendon = Tendon.helical(radius, angle, table.number("pitch"), end, friction)
    else:
        place = table.vector("offset", 2)
        tendon, radius = Tendon(place, end, friction), float(np.linalg.norm(place))
    table.close()
    if radius > disk_radius:
        raise table.fail(
            "offset", f"is {radius:g} m from the centre, off a disk of {disk_radius:g} m; move it."
        )
    if end > rod.length:
        raise table.fail("end", f"is {end:g} m, off a robot of {rod.length:g} m; shorten it.")
    return tendon


def _stage(table: Table, key: str) -> tuple[SlideLimits, float]:
    stage = table.subtable(key)
    limits = SlideLimits(*(stage.number(name) for name in ("stroke", "speed", "acceleration")))
    offset = stage.number("coil_offset", 0.0, positive=False)
    stage.close()
    return limits, offset


def _imperfections(table: Table) -> Imperfections:
    values: dict[str, Any] = {}
    for name, default in vars(Imperfections()).items():
        if name == "roll":
            values["roll"] = table.text("roll", default, ROLLS)
        elif isinstance(default, np.ndarray):
            values[name] = table.vector(name, default.size, default)
        else:
            values[name] = table.number(name, default, positive=False)
    table.close()
    return Imperfections(**values)
