"""Mechanical model of a robot: rod, tendons and loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import SimulationError
from glissando.geometry.se3 import Array
from glissando.model.tendons.channel import Channel

Field = Callable[[Array], Array]
"""A function of arclengths (M,) in metres, whose values (M, …) have a row for each."""


STRAIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Strain of a straight rod at its own length."""


def _require_finite(name: str, value: Array, shape: tuple[int, ...]) -> None:
    if value.shape != shape or not np.all(np.isfinite(value)):
        raise SimulationError(
            f"{name} is {value.tolist()}; give an array {shape} of finite numbers."
        )


@dataclass(frozen=True)
class Rod:
    """A linear-elastic Cosserat rod.

    Attributes:
        length: Length, m.
        stiffness: [shear x, shear y, extension] in N and [bending x, bending y, twist] in N m².
        rest_strain: Unloaded strain (6,), or a function of arclength (M,) → (M, 6).
        mass_per_length: Mass, kg/m.
        base: T_wb (4, 4) at s = 0.
        rotary_inertia: Moment of inertia per metre of rod about body x, y, z (3,), kg m.
        retardation: Kelvin–Voigt retardation time, s: damping is stiffness times retardation.
        air_damping: Drag of air per metre of rod and per velocity, N s/m².

    Source: Rucker and Webster 2011, equations (1) to (9).
    """

    length: float
    stiffness: Array
    rest_strain: Array | Field = field(default_factory=STRAIGHT.copy)
    mass_per_length: float = 0.0
    base: Array = field(default_factory=lambda: np.eye(4))
    rotary_inertia: Array = field(default_factory=lambda: np.zeros(3))
    retardation: float = 0.0
    air_damping: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in (("stiffness", (6,)), ("base", (4, 4)), ("rotary_inertia", (3,))):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
            _require_finite(name, getattr(self, name), shape)
        if not (np.isfinite(self.length) and self.length > 0.0):
            raise SimulationError(f"A rod of length {self.length:g} m cannot be; give metres > 0.")
        if not np.all(self.stiffness > 0.0):
            raise SimulationError(
                f"A rod's stiffness is {self.stiffness.tolist()}; give six numbers above zero: "
                f"shear, shear, extension (N), bending, bending, twist (N m²)."
            )
        for name in ("mass_per_length", "retardation", "air_damping", "rotary_inertia"):
            value = getattr(self, name)
            if not np.all(np.isfinite(value) & (np.asarray(value) >= 0.0)):
                raise SimulationError(f"A rod's {name} cannot be {value}; give zero or more.")
        _require_finite("rest_strain", self.rest(np.zeros(1)), (1, 6))

    def rest(self, arclength: Array) -> Array:
        """Strains (M, 6) of the unloaded rod at arclengths (M,)."""
        if callable(self.rest_strain):
            return np.asarray(self.rest_strain(arclength), dtype=float)
        strain = np.asarray(self.rest_strain, dtype=float)
        _require_finite("rest_strain", strain, (6,))
        return np.broadcast_to(strain, (arclength.size, 6))

    @staticmethod
    def of_tubes(
        length: float,
        diameters: Sequence[tuple[float, float]],
        *,
        young: float,
        poisson: float,
        density: float = 0.0,
        rest_strain: Array | Field = STRAIGHT,
        base: Array | None = None,
        retardation: float = 0.0,
        air_damping: float = 0.0,
    ) -> Rod:
        """Rod of concentric tubes of one material that bend together.

        Args:
            length: Length, m.
            diameters: Outer and inner diameter of each tube, m.
            young: Young's modulus, Pa.
            poisson: Poisson's ratio.
            density: Density, kg/m³.
            rest_strain: Unloaded strain (6,), or a function of arclength (M,) → (M, 6).
            base: T_wb (4, 4) at s = 0; the world's frame if None.
            retardation: Kelvin–Voigt retardation time, s.
            air_damping: Drag of air per metre of rod and per velocity, N s/m².

        Raises:
            SimulationError: A diameter or a ratio is impossible.

        >>> Rod.of_tubes(0.7, [(2e-3, 1.8e-3)], young=60e9, poisson=0.33).stiffness[3].round(4)
        np.float64(0.0162)
        """
        if not -1.0 < poisson <= 0.5:
            raise SimulationError(f"A Poisson's ratio of {poisson:g} cannot be; give −1 to 0.5.")
        area = inertia = 0.0
        for outer, inner in diameters:
            if not 0.0 <= inner < outer:
                raise SimulationError(
                    f"A tube of outer diameter {outer:g} m and inner {inner:g} m cannot be; give "
                    f"outer > inner ≥ 0."
                )
            area += np.pi / 4.0 * (outer**2 - inner**2)
            inertia += np.pi / 64.0 * (outer**4 - inner**4)
        shear = young / (2.0 * (1.0 + poisson))
        stiffness = [shear * area, shear * area, young * area]
        stiffness += [young * inertia, young * inertia, 2.0 * shear * inertia]
        base = np.eye(4) if base is None else base
        rotary = density * inertia * np.array([1.0, 1.0, 2.0])
        mass = density * area
        damping = {"retardation": retardation, "air_damping": air_damping}
        return Rod(length, np.array(stiffness), rest_strain, mass, base, rotary, **damping)


@dataclass(frozen=True)
class Tendon:
    """A tendon through holes in the disks, from the base to its end, where it is fixed.

    With friction, tension decreases from the base by the factor exp(−μ Θ), where Θ is the angle by
    which the backbone bends the tendon up to s, as while it is pulled (capstan equation; Kato et
    al. 2015).

    Attributes:
        offset: Position in the cross-section (2,), m, or a function of arclength (M,) → (M, 2).
        end: Arclength of the end, m.
        friction: Coefficient of friction μ.
    """

    offset: Array | Field
    end: float
    friction: float = 0.0

    def path(self, arclength: Array) -> tuple[Array, Array]:
        """Positions r (M, 3) in the cross-section and derivatives dr/ds (M, 3)."""
        place, slope = np.zeros((arclength.size, 3)), np.zeros((arclength.size, 3))
        if not callable(self.offset):
            offset = np.asarray(self.offset, dtype=float)
            _require_finite("A tendon's offset", offset, (2,))
            place[:, :2] = offset
            return place, slope
        inside = np.minimum(arclength, self.end)
        place[:, :2] = self.offset(inside)
        # derivative of a quartic through five points of the tendon: within 1e-9 for smooth paths
        step, stencil = 1e-4 * self.end, np.arange(-2.0, 3.0)
        at = np.clip(arclength, 2.0 * step, self.end - 2.0 * step)
        values = np.array([self.offset(at + k * step) for k in stencil])
        quartic = np.tensordot(np.linalg.inv(np.vander(stencil, increasing=True)), values, 1)
        x = ((inside - at) / step)[:, None]
        slope[:, :2] = sum(k * quartic[k] * x ** (k - 1) for k in range(1, 5)) / step
        return place, slope

    def channel(self) -> tuple[float, float, float]:
        """Radius (m), angle at the base (rad) and pitch (m, zero if straight) of the channel."""
        place, slope = (each[0] for each in self.path(np.zeros(1)))
        radius = float(np.linalg.norm(place))
        rate = float(np.cross(place, slope)[2] / radius**2)
        pitch = 2.0 * np.pi / rate if abs(rate) > 1e-9 else 0.0
        return radius, float(np.arctan2(place[1], place[0])), pitch

    @staticmethod
    def helical(
        radius: float, angle: float, pitch: float, end: float, friction: float = 0.0
    ) -> Tendon:
        """Tendon wound round the backbone once per `pitch` (m), from `angle` (rad) at the base."""

        def offset(arclength: Array) -> Array:
            turn = angle + 2.0 * np.pi * arclength / pitch
            return radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)

        return Tendon(offset, end, friction)

    @staticmethod
    def in_channel(channel: Channel, end: float) -> Tendon:
        """Frictionless tendon in a channel, from the base to `end` (m)."""
        if np.isfinite(channel.pitch):
            return Tendon.helical(channel.radius, channel.angle, channel.pitch, end)
        direction = np.array([np.cos(channel.angle), np.sin(channel.angle)])
        return Tendon(channel.radius * direction, end)


@dataclass(frozen=True)
class Wrench:
    """A dead load at `arclength` (m): `force` (3,) N and `moment` (3,) N m in the world frame."""

    arclength: float
    force: ArrayLike = (0.0, 0.0, 0.0)
    moment: ArrayLike = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Loads:
    """External loads on a rod: tendon `tensions` (T,) in N, `gravity` (3,) in m/s², `wrenches`."""

    tensions: ArrayLike = ()
    gravity: ArrayLike = (0.0, 0.0, 0.0)
    wrenches: Sequence[Wrench] = ()


def require_possible(rod: Rod, tendons: Sequence[Tendon], loads: Loads) -> None:
    """Raise SimulationError unless tendons and loads are on the rod and tensions are possible."""
    tensions = np.atleast_1d(np.asarray(loads.tensions, dtype=float))
    if tensions.shape != (len(tendons),):
        raise SimulationError(
            f"{tensions.size} tensions for {len(tendons)} tendons; give one a tendon, in newtons."
        )
    if not np.all(np.isfinite(tensions)) or np.any(tensions < 0.0):
        raise SimulationError(
            f"Tensions {tensions.tolist()} N cannot be: a tendon only pulls; give numbers ≥ 0."
        )
    for tendon in tendons:
        if not (np.isfinite(tendon.friction) and tendon.friction >= 0.0):
            raise SimulationError(
                f"A tendon's friction of {tendon.friction:g} cannot be; give a coefficient ≥ 0."
            )
        if not 0.0 < tendon.end <= rod.length + 1e-12:
            raise SimulationError(
                f"A tendon ends at {tendon.end:g} m, off a rod of {rod.length:g} m; end it on it."
            )
    for wrench in loads.wrenches:
        if not 0.0 <= wrench.arclength <= rod.length + 1e-12:
            raise SimulationError(
                f"A load acts at {wrench.arclength:g} m, off a rod of {rod.length:g} m; move it."
            )
    given = [loads.gravity, *(v for w in loads.wrenches for v in (w.force, w.moment))]
    for vector in given:
        if np.shape(vector) != (3,) or not np.all(np.isfinite(np.asarray(vector, dtype=float))):
            raise SimulationError(f"A load is {vector}; give three finite numbers x, y, z.")
