"""What happens to a moving rod: tendons, loads, contacts and its base over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.simulation.dynamics.base_motion import BaseMotion
from glissando.simulation.rod import Wrench
from glissando.simulation.rod_equations import AppliedLoads, RodEquations
from glissando.simulation.statics import beyond_base, site

_EVER = float("inf")


@dataclass(frozen=True)
class TimedWrench:
    """A dead load that acts from `start` until `stop`, s."""

    wrench: Wrench
    start: float = -_EVER
    stop: float = _EVER


@dataclass(frozen=True)
class HalfSpace:
    """Soft matter behind a plane, which pushes a rod that sinks into it.

    It pushes with `stiffness` times depth times (1 + `damping` times speed of sinking), never
    pulls, and rubs with Coulomb's friction, which fades below 1 mm/s of sliding.

    Attributes:
        point: A point of the plane (3,), m.
        normal: The direction out of it (3,), of any length.
        stiffness: Force on a metre of rod a metre deep, N/m².
        damping: Share of the force by speed, s/m. Source: Hunt and Crossley 1975.
        friction: Coefficient of friction.
        start, stop: Times from and until which it is there, s.
    """

    point: ArrayLike
    normal: ArrayLike
    stiffness: float
    damping: float = 0.0
    friction: float = 0.0
    start: float = -_EVER
    stop: float = _EVER

    def row(self) -> Array:
        """The half-space as a row (9,) of `AppliedLoads.planes`."""
        normal = np.asarray(self.normal, dtype=float)
        size = float(np.linalg.norm(normal))
        if normal.shape != (3,) or not (np.isfinite(size) and size > 0.0):
            raise SimulationError(f"A half-space's normal is {normal.tolist()}; give x, y, z.")
        _require("A half-space's stiffness", self.stiffness)
        _require("A half-space's damping", self.damping)
        _require("A half-space's friction", self.friction)
        numbers = [self.stiffness, self.damping, self.friction]
        return np.concatenate([np.asarray(self.point, dtype=float), normal / size, numbers])


@dataclass(frozen=True)
class Hold:
    """A spring with a damper that holds a point of the rod from `start` and lets go at `stop`.

    Attributes:
        arclength: Where on the rod, m.
        stiffness: Stiffness, N/m.
        damping: Damping, N s/m.
        place: Where it is held (3,), m; where it is at `start` unless given.
        start, stop: Times from and until which it is held, s.
    """

    arclength: float
    stiffness: float
    damping: float = 0.0
    place: ArrayLike | None = None
    start: float = 0.0
    stop: float = _EVER


def _require(name: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0.0):
        raise SimulationError(f"{name} is {value:g}; give a finite number, zero or more.")


@dataclass(frozen=True)
class Scenario:
    """What acts on a rod over time.

    What starts at 0 or before acts at the first instant too, when the rod is still at rest, so a
    load until 0 is one that is let go at 0.

    Attributes:
        tensions: Tension of each tendon (T,), N, at a time in seconds; constant numbers will do.
        displacements: How far each tendon is pulled (T,), m, in the place of tensions.
        tendon_stiffness: Stiffness of each tendon (T,), N/m, if displacements are given.
        gravity: Gravity (3,), m/s².
        wrenches: Loads.
        half_spaces: Soft matter.
        holds: Points that are held.
        base: Motion of the base; it stays unless given.
        jumps: Times at which tensions, displacements or their slopes jump, s.
    """

    tensions: Callable[[float], Array] | ArrayLike = ()
    displacements: Callable[[float], Array] | None = None
    tendon_stiffness: ArrayLike = ()
    gravity: ArrayLike = (0.0, 0.0, 0.0)
    wrenches: tuple[TimedWrench, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()
    holds: tuple[Hold, ...] = ()
    base: BaseMotion | None = None
    jumps: tuple[float, ...] = ()

    @property
    def events(self) -> Array:
        """Times at which something begins, ends or jumps, in order."""
        timed: list[TimedWrench | HalfSpace | Hold] = []
        timed += [*self.wrenches, *self.half_spaces, *self.holds]
        times = [t for each in timed for t in (each.start, each.stop)]
        times += [*self.jumps, *(self.base.time if self.base else ())]
        return np.unique([t for t in times if np.isfinite(t)])

    @property
    def places(self) -> list[float]:
        """Arclengths at which loads and holds act, m."""
        return [w.wrench.arclength for w in self.wrenches] + [h.arclength for h in self.holds]


@dataclass
class ScenarioLoads:
    """A scenario on a rod's equations; it keeps where points were when they were taken hold of."""

    scenario: Scenario
    equations: RodEquations
    planes: list[Array] = field(init=False)
    anchors: dict[int, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.planes = [plane.row() for plane in self.scenario.half_spaces]
        for hold in self.scenario.holds:
            _require("A hold's stiffness", hold.stiffness)
            _require("A hold's damping", hold.damping)
        self.natural = self._natural_lengths()

    def _natural_lengths(self) -> Array:
        rest, paths = self.equations.rest, self.equations.paths
        along = rest[:, :3] + np.cross(rest[:, 3:], paths[:, 0]) + paths[:, 1]
        weights = paths[:, 2, :, 0] * self.equations.mesh.weights
        lengths: Array = np.sum(weights * np.linalg.norm(along, axis=-1), axis=1)
        return lengths

    def take_hold(self, moment: float, places: Array) -> None:
        """Note where points are that are taken hold of by a moment; `places` (E, 3) of ends."""
        for k, hold in enumerate(self.scenario.holds):
            if k not in self.anchors and hold.start <= moment < hold.stop:
                row = int(site(self.equations.mesh, Wrench(hold.arclength))[0])
                self.anchors[k] = np.array(places[row] if hold.place is None else hold.place)

    def at(self, time: float, moment: float) -> AppliedLoads:
        """What acts at a time, of what is there at a `moment` of the same stretch between events.

        At the first instant the moment is −∞ for what then ends, and 0 for what begins.
        """
        scenario, mesh = self.scenario, self.equations.mesh
        base, rates = self.equations.rod.base, np.zeros((4, 3))
        if scenario.base is not None:
            base, rates = scenario.base.at(time)
        acting = [timed.wrench for timed in scenario.wrenches if _is_there(timed, moment)]
        sites = [site(mesh, wrench) for wrench in acting]
        for k, hold in enumerate(scenario.holds):
            if _is_there(hold, moment) and k in self.anchors:
                row = site(mesh, Wrench(hold.arclength))
                row[7:10], row[10], row[11] = self.anchors[k], hold.stiffness, hold.damping
                sites.append(row)
        half_spaces = zip(scenario.half_spaces, self.planes, strict=True)
        planes = [row for plane, row in half_spaces if _is_there(plane, moment)]
        return AppliedLoads(
            np.ascontiguousarray(base),
            np.asarray(scenario.gravity, dtype=float),
            self._cables(time),
            beyond_base(sites),
            np.reshape(planes, (-1, 9)),
            rates,
        )

    def _cables(self, time: float) -> Array:
        scenario, tendons = self.scenario, self.equations.tendons
        cables = np.zeros((len(tendons), 4))
        cables[:, 3] = [tendon.friction for tendon in tendons]
        if scenario.displacements is not None:
            stiffness = np.asarray(scenario.tendon_stiffness, dtype=float)
            cables[:, 0] = stiffness * scenario.displacements(time)
            cables[:, 1], cables[:, 2] = stiffness, self.natural
            return cables
        given = scenario.tensions
        cables[:, 0] = given(time) if callable(given) else np.asarray(given, dtype=float)
        return cables


def _is_there(timed: TimedWrench | HalfSpace | Hold, moment: float) -> bool:
    """Whether it acts; before the first instant what starts by 0 does."""
    if moment < 0.0:
        return timed.start <= 0.0 and timed.stop >= 0.0
    return timed.start <= moment < timed.stop
