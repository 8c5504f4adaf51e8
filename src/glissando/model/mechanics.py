"""A rod's mechanics: stiffness and mass of its segments, gravity, and a tool at the tip.

An internal wrench W = [n; m] is exerted by the part beyond a cross-section on the part before it,
in the body frame, [force N, moment N m]. Source: equation (26).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.field_checks import FieldChecks
from glissando.model.grid import SAME, Index, segment_at
from glissando.model.table import Table

_GRAVITY = 9.81  # m/s², only to judge whether a rod could carry its own weight
_REACHES = np.finfo(float).max  # end of a tube for which none is given
_DROOP = 1e4  # weight · length² / bending stiffness above which a unit is wrong


@dataclass(frozen=True)
class Mechanics:
    """Stiffness, mass and tool of a rod of S segments.

    Attributes:
        stiffness: Of each segment (S, 6): shear, shear, extension in N; bending, bending, twist in
            N m².
        mass_per_length: Of each segment (S,), or one for all, kg/m.
        joints: Arclengths (S−1,) at which segments meet, m.
        gravity: Acceleration (3,) in the world frame, m/s²; or (M, 3), one for each static shape.
        tip_mass: Mass of a tool at the tip, kg.
        tip_center: Its centre of mass (3,) in the frame of the tip's cross-section, m.
        end: Arclength at which the last tube ends, at the tip or beyond, m.
    """

    stiffness: Array
    mass_per_length: Array = field(default_factory=lambda: np.zeros(1))
    joints: Array = field(default_factory=lambda: np.zeros(0))
    gravity: Array = field(default_factory=lambda: np.zeros(3))
    tip_mass: float = 0.0
    tip_center: Array = field(default_factory=lambda: np.zeros(3))
    end: float = _REACHES

    def __post_init__(self) -> None:
        stated = FieldChecks(self)
        count = stated.places("joints").size + 1
        stiffness = stated.numbers("stiffness", (6,), (count, 6), above=0.0).reshape(-1, 6)
        if len(stiffness) != count:
            raise stated.fail("stiffness", f"has one row for {count} segments; give one each.")
        object.__setattr__(self, "stiffness", stiffness)
        mass = stated.numbers("mass_per_length", (), (1,), (count,), least=0.0)
        object.__setattr__(self, "mass_per_length", np.broadcast_to(mass, count).copy())
        stated.numbers("gravity", (3,), (-1, 3))
        stated.number("tip_mass", least=0.0)
        stated.numbers("tip_center", (3,))

    def segment(self, arclength: Array) -> Index:
        """Index (M,) of the segment at arclengths (M,); at a joint that of the segment beyond."""
        return segment_at(self.joints, arclength)

    def tip_wrench(self, rotation: Array) -> Array:
        """Wrench (…, 6) of the tool's weight in the tip's frame, whose rotation is (…, 3, 3)."""
        force = self._tip_force(rotation)
        return np.concatenate([force, np.cross(self.tip_center, force)], axis=-1)

    def tip_slope(self, rotation: Array) -> Array:
        """Jacobian (…, 6, 3) of `tip_wrench` by a rotation of the tip in its own frame."""
        by_turn = se3.hat3(self._tip_force(rotation))
        return np.concatenate([by_turn, se3.hat3(self.tip_center) @ by_turn], axis=-2)

    def _tip_force(self, rotation: Array) -> Array:
        return self.tip_mass * np.einsum("...ji,...j->...i", rotation, self.gravity)

    def to_table(self) -> dict[str, Any]:
        """Table [mechanics] of a robot file, in the form that `read_mechanics` reads."""
        table: dict[str, Any] = {
            "stiffness": self.stiffness.tolist(),
            "mass_per_length": self.mass_per_length.tolist(),
            "gravity": self.gravity.tolist(),
        }
        if self.joints.size:
            table["joints"] = self.joints.tolist()
        if self.tip_mass:
            table["tip"] = {"mass": self.tip_mass, "center": self.tip_center.tolist()}
        return table


def tube_section(tubes: list[tuple[float, float]], young: float, poisson: float) -> Array:
    """Stiffness (6,) of concentric tubes of one material that bend together.

    Args:
        tubes: Outer and inner diameter of each, m.
        young: Young's modulus, Pa.
        poisson: Poisson's ratio.
    """
    shear = young / (2.0 * (1.0 + poisson))
    area, inertia = _area(tubes), sum(np.pi / 64.0 * (a**4 - b**4) for a, b in tubes)
    linear = [shear * area, shear * area, young * area]
    return np.array([*linear, young * inertia, young * inertia, 2.0 * shear * inertia])


def _area(tubes: list[tuple[float, float]]) -> float:
    return float(sum(np.pi / 4.0 * (outer**2 - inner**2) for outer, inner in tubes))


def read_mechanics(robot: Table) -> Mechanics | None:
    """Mechanics from the table [mechanics] of a robot file, or None without that table.

    It has `tubes` with `young`, `poisson` and `density`, or `stiffness` with `mass_per_length`.

    Raises:
        GlissandoError: A value is missing, impossible, or most likely in another unit.
    """
    table = robot.table("mechanics")
    if table is None:
        return None
    fields = _tubes(table) if table.peek("tubes") is not None else _sections(table)
    gravity = table.vector("gravity", 3, np.zeros(3))
    tip = table.table("tip")
    if tip is not None:
        center = tip.vector("center", 3, np.zeros(3))
        fields |= {"tip_mass": tip.number("mass"), "tip_center": center}
        tip.close()
    table.close()
    return Mechanics(gravity=gravity, **fields)


def strange_gravity(gravity: Array) -> str:
    """Message about an implausible acceleration, (3,) or (M, 3), m/s²; empty if plausible."""
    size = np.linalg.norm(np.atleast_2d(gravity), axis=1)
    wrong = size[(size > 0.0) & ((size < 1.5) | (size > 30.0))]
    if not wrong.size:
        return ""
    return f"has length {wrong[0]:g}; give the acceleration in m/s², as [0, 0, -9.81]."


def implausible(mechanics: Mechanics, length: float) -> tuple[str, str] | None:
    """Field of a rod's mechanics that is probably in a wrong unit, with a message; else None.

    Args:
        mechanics: The mechanics to check.
        length: Length of the rod, m.
    """
    if strange := strange_gravity(mechanics.gravity):
        return "gravity", strange
    if mechanics.tip_mass > 5.0:
        return "tip mass", f"is {mechanics.tip_mass:g} kg; give kilograms, not grams."
    if np.linalg.norm(mechanics.tip_center) > 0.5:
        return "tip center", f"is {mechanics.tip_center.tolist()}; give metres, not millimetres."
    if np.any(mechanics.mass_per_length > 50.0):
        return "mass_per_length", f"is {mechanics.mass_per_length.max():g}; give kg/m."
    if mechanics.joints.size and mechanics.joints[-1] >= length:
        return "joints", (
            f"begin a segment at {mechanics.joints[-1]:g} m, beyond the tip at {length:g} m; give "
            f"arclengths in metres."
        )
    if mechanics.end < length - SAME:
        return "tubes", (
            f"all end by {mechanics.end:g} m, before the tip at {length:g} m; leave `end` out for "
            f"a tube that reaches the tip."
        )
    return _too_thick(mechanics) or _too_soft(mechanics, length)


def _too_thick(mechanics: Mechanics) -> tuple[str, str] | None:
    """Field and message if bending over extension stiffness implies an impossible thickness."""
    gyration = np.sqrt(mechanics.stiffness[:, 3:5].max(axis=1) / mechanics.stiffness[:, 2])
    if np.all((gyration <= 0.1) & (gyration >= 1e-6)):
        return None
    return "stiffness", (
        f"is {mechanics.stiffness.tolist()}, whose bending over extension belongs to a rod "
        f"{2 * gyration.max():.2g} m thick; give N for shear and extension, N m² for bending and "
        f"twist."
    )


def _too_soft(mechanics: Mechanics, length: float) -> tuple[str, str] | None:
    """Field and message if a rod of that bending stiffness would collapse under its weight."""
    bending = mechanics.stiffness[:, 3:5].min(axis=1)
    weight = _GRAVITY * (mechanics.mass_per_length * length + mechanics.tip_mass)
    droop = weight * length**2 / bending
    if droop.max() <= _DROOP:
        return None
    worst = int(np.argmax(droop))
    return "stiffness", (
        f"in bending is {bending[worst]:.3g} N m², with {mechanics.mass_per_length[worst]:.3g} "
        f"kg/m and {mechanics.tip_mass:.3g} kg at the tip: over {length:g} m the rod could not "
        f"carry its own weight. Give young in Pa (200e9, not 200 GPa or 200e3 N/mm²), stiffness in "
        f"N and N m², masses in kg and lengths in metres."
    )


def _tubes(table: Table) -> dict[str, Any]:
    """Fields of `Mechanics` from concentric tubes: a segment between successive ends."""
    young = table.number("young")
    if not 1e4 <= young <= 2e12:
        raise table.fail("young", f"is {young:g} Pa; give pascals: 200e9 for 200 GPa.")
    poisson = table.number("poisson", positive=False)
    if not -1.0 < poisson <= 0.5:
        raise table.fail("poisson", f"is {poisson:g}; give a ratio from −1 to 0.5.")
    density = table.number("density", 0.0, positive=False)
    if density and not 50.0 <= density <= 25e3:
        raise table.fail("density", f"is {density:g}; give kg/m³: 7870 for steel, 7.87 g/cm³.")
    ends, tubes = [], []
    for entry in table.tables("tubes"):
        outer, inner = entry.number("outer"), entry.number("inner", 0.0, positive=False)
        if not 0.0 <= inner < outer:
            raise entry.fail("outer", f"is {outer:g} and inner {inner:g}; give outer > inner ≥ 0.")
        if outer > 0.2:
            raise entry.fail("outer", f"is {outer:g} m; give diameters in metres, not millimetres.")
        ends.append(entry.number("end", _REACHES))
        tubes.append((outer, inner))
        entry.close()
    if not tubes:
        raise table.fail("tubes", "is empty; give one tube or more, or `stiffness`.")
    for (wide, hollow), (outer, _) in pairwise(sorted(tubes, reverse=True)):
        if hollow < outer:
            raise table.fail(
                "tubes",
                f"has one of {wide:g} m outside and {hollow:g} m inside about one of {outer:g} m "
                f"outside; concentric tubes fit into each other.",
            )
    joints = np.unique(ends)[:-1]
    here = [[t for t, end in zip(tubes, ends, strict=True) if end > s] for s in [0.0, *joints]]
    return {
        "stiffness": np.array([tube_section(each, young, poisson) for each in here]),
        "mass_per_length": np.array([density * _area(each) for each in here]),
        "joints": joints,
        "end": max(ends, default=_REACHES),
    }


def _sections(table: Table) -> dict[str, Any]:
    """Fields of `Mechanics` from the stiffness of each segment."""
    joints = table.places("joints")
    rows = table.peek("stiffness")
    several = isinstance(rows, list) and bool(rows) and isinstance(rows[0], list)
    if several or joints.size:
        stiffness = table.rows("stiffness", joints.size + 1, 6)
    else:
        stiffness = table.vector("stiffness", 6, positive=True)[None]
    mass = table.peek("mass_per_length")
    if isinstance(mass, list):
        masses = table.vector("mass_per_length", joints.size + 1)
    else:
        single = table.number("mass_per_length", 0.0, positive=False)
        masses = np.full(joints.size + 1, single)
    if np.any(masses < 0.0):
        raise table.fail("mass_per_length", f"is {mass!r}; give kg/m, zero or more.")
    return {"stiffness": stiffness, "mass_per_length": masses, "joints": joints}
