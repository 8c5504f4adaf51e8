"""Scenario of a moving rod: tendons, loads, contacts and motion of the base over time."""

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
    """Dead load that acts from `start` until `stop`, s."""

    wrench: Wrench
    start: float = -_EVER
    stop: float = _EVER


@dataclass(frozen=True)
class HalfSpace:
    """Compliant half-space behind a plane that repels a penetrating rod.

    The normal force per metre is stiffness · depth · (1 + damping · speed of penetration), never
    tensile. Coulomb friction is added, regularised below a sliding speed of 1 mm/s.

    Attributes:
        point: A point of the plane (3,), m.
        normal: Outward direction of the plane (3,), of any length.
        stiffness: Force per metre of rod and per metre of depth, N/m².
        damping: Relative increase of the force with speed, s/m. Source: Hunt and Crossley 1975.
        friction: Coefficient of friction.
        start, stop: Times between which the half-space exists, s.
    """

    point: ArrayLike
    normal: ArrayLike
    stiffness: float
    damping: float = 0.0
    friction: float = 0.0
    start: float = -_EVER
    stop: float = _EVER

    def row(self) -> Array:
        """Row (9,) of `AppliedLoads.planes` for the half-space."""
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
    """Spring and damper that hold a point of the rod from `start` and release it at `stop`.

    Attributes:
        arclength: Arclength of the point, m.
        stiffness: Stiffness, N/m.
        damping: Damping, N s/m.
        place: Anchor (3,) in the world, m; by default the position of the point at `start`.
        start, stop: Times between which the point is held, s.
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
    """Tendons, loads, contacts and motion of the base over time.

    Loads with start ≤ 0 ≤ stop also act on the initial static shape, so a load that stops at 0 is
    released at 0.

    Attributes:
        tensions: Function of time (s) that returns tensions (T,), N, or constant tensions.
        displacements: Function of time (s) that returns displacements (T,) of the tendons, m,
            which replace tensions; None if unused.
        tendon_stiffness: Stiffness of each tendon (T,), N/m, if displacements are given.
        gravity: Gravity (3,), m/s².
        wrenches: Dead loads.
        half_spaces: Compliant half-spaces.
        holds: Springs at points of the rod.
        base: Motion of the base; None if it is fixed.
        jumps: Times at which tensions, displacements or their derivatives jump, s.
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
        """Sorted times at which loads start, stop or jump, s."""
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
    """Scenario applied to a rod's equations, with the anchors of holds that have started."""

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
        """Store the anchors of holds active at `moment` (s); `places` (E, 3) are element ends."""
        for k, hold in enumerate(self.scenario.holds):
            if k not in self.anchors and hold.start <= moment < hold.stop:
                row = int(site(self.equations.mesh, Wrench(hold.arclength))[0])
                self.anchors[k] = np.array(places[row] if hold.place is None else hold.place)

    def at(self, time: float, moment: float) -> AppliedLoads:
        """Loads at a time, s, with those active that are active at `moment`, s.

        `moment` is any time inside the same interval between events, which resolves the ambiguity
        at an event; a negative one selects the loads on the initial static shape.
        """
        scenario, mesh = self.scenario, self.equations.mesh
        base, rates = self.equations.rod.base, np.zeros((4, 3))
        if scenario.base is not None:
            base, rates = scenario.base.at(time)
        acting = [timed.wrench for timed in scenario.wrenches if _is_active(timed, moment)]
        sites = [site(mesh, wrench) for wrench in acting]
        for k, hold in enumerate(scenario.holds):
            if _is_active(hold, moment) and k in self.anchors:
                row = site(mesh, Wrench(hold.arclength))
                row[7:10], row[10], row[11] = self.anchors[k], hold.stiffness, hold.damping
                sites.append(row)
        half_spaces = zip(scenario.half_spaces, self.planes, strict=True)
        planes = [row for plane, row in half_spaces if _is_active(plane, moment)]
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
        tensions = scenario.tensions
        cables[:, 0] = tensions(time) if callable(tensions) else np.asarray(tensions, dtype=float)
        return cables


def _is_active(timed: TimedWrench | HalfSpace | Hold, moment: float) -> bool:
    """Whether a load is active at `moment`, s; if negative, on the initial static shape."""
    if moment < 0.0:
        return timed.start <= 0.0 and timed.stop >= 0.0
    return timed.start <= moment < timed.stop
