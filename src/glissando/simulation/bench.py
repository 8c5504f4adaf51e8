"""The [physics] table of a robot file: rod, tendons, stage, tracker, and shapes with names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.io.toml_table import Table, read_toml
from glissando.model.slide_path import SlideLimits
from glissando.simulation.imperfections import ROLLS, Imperfections, SmoothField
from glissando.simulation.motion import Motion, solve_motion
from glissando.simulation.rod import STRAIGHT, Loads, Rod, Tendon, Wrench

_FRAME = 0.2  # s between solved shapes of a robot that moves
_FEWEST, _MOST = 10, 20_000  # of them between two times of an actuation


@dataclass(frozen=True)
class Actuation:
    """What pulls on a robot over time; between two times tensions change as 3x² − 2x³.

    Attributes:
        time: Times (K,), s.
        tensions: Tension of every tendon at these times (K, T), N.
        gravity: Gravity (3,), m/s².
        wrenches: Dead loads.
    """

    time: Array
    tensions: Array
    gravity: Array
    wrenches: tuple[Wrench, ...] = ()

    def loads_at(self, time: float) -> Loads:
        """The loads at a time in seconds."""
        last = self.time.size - 1
        k = int(np.clip(np.searchsorted(self.time, time, "right") - 1, 0, last))
        tensions = self.tensions[k]
        if k < last:
            x = np.clip((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 0.0, 1.0)
            tensions = tensions + x * x * (3.0 - 2.0 * x) * (self.tensions[k + 1] - tensions)
        return Loads(tensions, self.gravity, self.wrenches)

    def lasting(self, duration: float) -> Actuation:
        """The same tensions stretched over another time, from 0 to `duration` seconds."""
        if self.time.size == 1:
            return self
        start, stop = self.time[0], self.time[-1]
        return replace(self, time=(self.time - start) * (duration / (stop - start)))


@dataclass(frozen=True)
class Bench:
    """A robot with its sensors on a bench, as the simulator knows it.

    Attributes:
        rod: Its tubes.
        tendons: Its tendons.
        gravity: Gravity (3,), m/s².
        slide: Limits of the stage that slides the coil.
        full_slide: A stage as long as the robot, which exists in simulation only.
        coil_offset: Place of the coil, from the tip, at displacement zero, m.
        tracker: Pose T_wt (4, 4) of the tracker.
        flaws: Imperfections of robot and sensors.
        truth: Arclengths of the motion capture frames (C,), m.
        shapes: Actuations by name.
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

    def shape(self, name: str) -> Actuation:
        """A shape of the robot file by name, or of a TOML file by path.

        Raises SimulationError when there is neither.
        """
        if name in self.shapes:
            return self.shapes[name]
        path = Path(name)
        if not path.is_file():
            raise SimulationError(
                f"There is no shape named {name!r} and no such file; give a TOML file with "
                f"tensions, or one of {', '.join(self.shapes)}."
            )
        table = read_toml(path, SimulationError)
        return _actuation(table, len(self.tendons), self.gravity)

    def move(self, actuation: Actuation, flaws: Imperfections, seed: int) -> Motion:
        """The static shapes of an actuation, in time, of a robot with the set that `seed` gives it.

        Raises SimulationError for a motion that is too long, NoShapeError where the rod buckles.
        """
        rod = self.rod
        if flaws.set_curvature > 0.0:
            rng = np.random.default_rng([seed, 1])
            bent = SmoothField.draw(rng, 1, 2, flaws.set_length)

            def rest(arclength: Array) -> Array:
                strain = np.array(self.rod.rest(arclength))
                strain[:, 3:5] += flaws.set_curvature * bent(arclength[:, None])
                return strain

            rod = replace(rod, rest_strain=rest)
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


def load_bench(path: Path) -> Bench:
    """The bench that a robot file's [physics] describes. Raises SimulationError without one."""
    table = read_toml(path, SimulationError)
    physics, base = table.table("physics"), table.table("base")
    if physics is None:
        raise SimulationError(
            f"{path.name} has no [physics]: it can be estimated, not simulated. Add its tubes, "
            f"tendons and stage, or choose another robot."
        )
    length, rest = table.number("length"), table.vector("rest_strain", 6, STRAIGHT)
    return _bench(physics, length, rest, base.pose() if base else np.eye(4))


def _bench(table: Table, length: float, rest_strain: Array, base: Array) -> Bench:
    gravity = table.vector("gravity", 3, np.zeros(3))
    rod = _rod(table, length, rest_strain, base)
    radius = table.number("disk_radius")
    tendons = tuple(_tendon(entry, rod, radius) for entry in table.tables("tendons"))
    slide, offset = _stage(table, "slide")
    full_slide, _ = _stage(table, "full_slide")
    mount = table.table("tracker", required=True)
    assert mount is not None
    tracker = mount.pose()
    mount.close()
    listed = table.table("imperfections")
    flaws = _imperfections(listed) if listed else Imperfections()
    places = _places(table, length)
    if not 0.0 <= length + offset <= length:
        raise table.fail("coil_offset", f"is {offset:g} m, off the robot; give −{length:g} to 0.")
    shapes = {}
    if (entries := table.table("shapes")) is not None:
        for name in entries.names():
            entry = entries.table(name, required=True)
            assert entry is not None
            shapes[name] = _actuation(entry, len(tendons), gravity)
    table.close()
    return Bench(rod, tendons, gravity, slide, full_slide, offset, tracker, flaws, places, shapes)


def _places(table: Table, length: float) -> Array:
    given = table.peek("truth_arclengths")
    if not isinstance(given, list) or not given:
        raise table.fail("truth_arclengths", f"is {given!r}; give a list of places in metres.")
    places = table.vector("truth_arclengths", len(given), pairs=False)
    if np.any(places < 0.0) or np.any(places > length) or np.unique(places).size < places.size:
        raise table.fail(
            "truth_arclengths", f"is {given}; give each place once, 0 to {length:g} m."
        )
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
    )
    disks = table.number("disk_mass_per_length", 0.0, positive=False)
    return replace(rod, mass_per_length=rod.mass_per_length + disks)


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
    stage = table.table(key, required=True)
    assert stage is not None
    limits = SlideLimits(*(stage.number(name) for name in ("stroke", "speed", "acceleration")))
    offset = stage.number("coil_offset", 0.0, positive=False)
    stage.close()
    return limits, offset


def _imperfections(table: Table) -> Imperfections:
    given: dict[str, Any] = {}
    for name, default in vars(Imperfections()).items():
        if name == "roll":
            given["roll"] = table.text("roll", default, ROLLS)
        elif isinstance(default, np.ndarray):
            given[name] = table.vector(name, default.size, default)
        else:
            given[name] = table.number(name, default, positive=False)
    table.close()
    return Imperfections(**given)


def _actuation(table: Table, tendons: int, gravity: Array) -> Actuation:
    """Keys tensions (and time, one a row of them), gravity, and [[loads]]."""
    tensions = table.matrix("tensions", tendons)
    time = np.zeros(1)
    if len(tensions) > 1 or table.peek("time") is not None:
        time = table.vector("time", len(tensions))
        if np.any(np.diff(time) <= 0.0):
            raise table.fail("time", f"is {time.tolist()}; give times that increase.")
    if np.any(tensions < 0.0):
        raise table.fail("tensions", f"is {tensions.tolist()}; a tendon only pulls, give N ≥ 0.")
    gravity = table.vector("gravity", 3, gravity)
    wrenches = []
    for entry in table.tables("loads"):
        force, moment = (entry.vector(key, 3, np.zeros(3)) for key in ("force", "moment"))
        wrenches.append(Wrench(entry.number("arclength"), force, moment))
        entry.close()
    table.close()
    return Actuation(time, tensions, gravity, tuple(wrenches))
