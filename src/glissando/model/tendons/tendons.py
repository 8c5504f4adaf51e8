"""A robot's tendons: channels, ends, elasticity, slack and play; table [tendons] of a file.

A tendon runs beside the backbone in a straight or helical channel from the base to its end. Its
displacement, positive when pulled, shortens it between base and end, takes up slack, and stretches
it. Source: (M5) and (M6) of docs/tendons.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from glissando.errors import SensorError
from glissando.geometry.se3 import Array
from glissando.model.mechanics import Mechanics
from glissando.model.table import Table
from glissando.model.tendons.channel import LONGEST_PITCH, MOST_TURNED, Channel
from glissando.model.tendons.replicate import Replicate, read_replicates

_LONGEST = 50.0  # m of a robot
_LARGEST_RADIUS = 0.1  # m, beyond which a radius was most likely given in millimetres
_EACH = ("radius", "angle", "pitch", "end", "stiffness", "slack", "play", "friction")
_SHARED = {"softness": 1e-4, "std": 1e-4, "psd_moment": 1e-7}
_OPTIONAL = {"pitch": 0.0, "slack": 0.0, "play": 0.0, "friction": 0.0}
_OTHERS = ("replicates", "left_open")
_ZERO = 0.05  # m, largest slack, which may include the offset of a servo's zero
_TRAVEL = 10.0  # rad; times the radius, the largest slack, play or error of a tendon
_STICKING = 2.0  # largest coefficient of friction
_SOFT = 0.05  # least stiffness of tendons over that of the rod; below, a unit is wrong


def _numbered(count: int) -> tuple[str, ...]:
    return tuple(f"tendon_{j}" for j in range(count))


@dataclass(frozen=True)
class Tendons:
    """T tendons.

    Attributes:
        radius: Distance from the backbone (T,), m.
        angle: Angle in the cross-section of the base (T,), rad.
        end: Arclength at which each is attached (T,), m.
        stiffness: Tension per stretch (T,), N/m.
        pitch: Metres for a whole turn (T,); infinite for a straight channel.
        slack: Displacement at which each becomes taut in the straight robot (T,), m.
        play: Displacement that is lost at a reversal of the servo (T,), half to each side, m.
        friction: Coefficient of friction in the channel (T,).
        softness: Displacement over which a tendon becomes taut, m.
        std: Standard deviation of displacements about the commands, m.
        psd_moment: Density of unmodelled bending moments, white along arclength, N² m³.
        learned_to: Largest displacement of each (T,) in the data from which these parameters were
            learned, m; infinite if unknown.
        replicates: Parameters as learned without each part of the recording, for their
            uncertainty; empty if unknown.
        left_open: Parameters moved by a standard deviation along what that recording left to the
            prior, such as a rotation of its tracker.
        names: Column names of the tendons in files.
    """

    radius: Array
    angle: Array
    end: Array
    stiffness: Array
    pitch: Array = field(default_factory=lambda: np.full(1, np.inf))
    slack: Array = field(default_factory=lambda: np.zeros(1))
    play: Array = field(default_factory=lambda: np.zeros(1))
    friction: Array = field(default_factory=lambda: np.zeros(1))
    softness: float = 1e-4
    std: float = 1e-4
    psd_moment: float = 1e-7
    learned_to: Array = field(default_factory=lambda: np.full(1, np.inf))
    replicates: tuple[Replicate, ...] = ()
    left_open: tuple[Replicate, ...] = ()
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = max(np.size(getattr(self, name)) for name in _EACH)
        for name in _EACH:
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape not in ((), (1,), (count,)):
                raise SensorError(
                    f"Tendons: {name} has {value.size} numbers for {count} tendons; give one each."
                )
            object.__setattr__(self, name, np.broadcast_to(value, count).copy())
        learned_to = np.broadcast_to(np.asarray(self.learned_to, dtype=float), count).copy()
        object.__setattr__(self, "learned_to", learned_to)
        names = self.names or _numbered(count)
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise SensorError(f"Tendons: two are named {twice[0]!r}; give each its own column.")
        if len(names) != count:
            raise SensorError(f"Tendons: {len(names)} names for {count} tendons; give one each.")
        object.__setattr__(self, "names", names)
        _require_units(self, lambda name, problem: SensorError(f"Tendons: {name} {problem}"))

    def __len__(self) -> int:
        return int(self.radius.size)

    @property
    def named(self) -> bool:
        """Whether the tendons have custom names, by which columns of files are matched."""
        return self.names != _numbered(len(self))

    @property
    def straight(self) -> bool:
        """Whether every channel is straight."""
        return bool(np.all(np.isinf(self.pitch)))

    def path(self, arclength: Array) -> tuple[Array, Array]:
        """Positions r (T, P, 3) in the cross-section at arclengths (P,), and dr/ds (T, P, 3)."""
        every = zip(self.radius, self.angle, self.pitch, strict=True)
        place, slope = zip(*(Channel(*one).path(arclength) for one in every), strict=True)
        return np.stack(place), np.stack(slope)

    def effective(self, displacement: Array) -> Array:
        """Displacements (M, T) that reach the robot through the play, from commands in order.

        The play operator: the robot's end follows only once the servo has taken up the play. The
        initial position within the play is unknown: this is the mean over all of them.
        """
        return self._effective_moments(displacement)[0]

    def std_in_play(self, displacement: Array) -> Array:
        """Standard deviations (M, T) of `effective`, by the unknown initial position in play."""
        return self._effective_moments(displacement)[1]

    def _effective_moments(self, displacement: Array) -> tuple[Array, Array]:
        """Mean and standard deviation (M, T) of `effective` over initial positions in the play.

        These are uniform in the play; those that the servo has carried along lie at one end.
        """
        half = 0.5 * self.play
        if not half.any():
            return np.array(displacement, dtype=float), np.zeros(displacement.shape)
        first, last = displacement[0] - half, displacement[0] + half
        ends = np.empty((2, *displacement.shape))
        reached = np.stack([first, last])
        for k, pulled in enumerate(displacement):
            ends[:, k] = reached = np.clip(reached, pulled - half, pulled + half)
        play = np.where(half > 0.0, self.play, 1.0)
        at_low, at_high = np.clip([(ends[0] - first) / play, (last - ends[1]) / play], 0.0, 1.0)
        mean, width = 0.5 * (ends[0] + ends[1]), ends[1] - ends[0]
        off = 0.5 * width * (at_high - at_low)
        square = width**2 / 12.0 + (at_low + at_high) * width**2 / 6.0
        return mean + off, np.sqrt(np.maximum(square - off**2, 0.0))

    def tension(self, stretch: Array) -> tuple[Array, Array]:
        """Tension (…, T), N, at a stretch (…, T), m, and its slope, N/m: about zero if slack.

        A softened ramp: stiffness · softness · log(1 + exp(stretch / softness)).
        """
        x = stretch / self.softness
        tension = self.stiffness * self.softness * np.logaddexp(0.0, x)
        return tension, self.stiffness * 0.5 * (1.0 + np.tanh(0.5 * x))

    def settings(self) -> dict[str, Array]:
        """Settings of `TendonReadings` for a stream of displacements of these tendons."""
        pitch = np.where(np.isinf(self.pitch), 0.0, self.pitch)
        named = ("radius", "angle", "end", "slack")
        return {**{name: getattr(self, name) for name in named}, "pitch": pitch}

    def to_table(self) -> dict[str, Any]:
        """Table [tendons] of a robot file, in the form that `read_tendons` reads."""
        table: dict[str, Any] = {"names": list(self.names)}
        for name in _EACH:
            value = getattr(self, name)
            if name != "pitch":
                table[name] = value.tolist()
            elif not self.straight:
                table[name] = np.where(np.isinf(value), 0.0, value).tolist()
        table |= {name: float(getattr(self, name)) for name in _SHARED}
        if np.isfinite(self.learned_to).all():
            table["learned_to"] = self.learned_to.tolist()
        for name in _OTHERS:
            if others := getattr(self, name):
                table[name] = [other.to_table() for other in others]
        return table


def read_tendons(robot: Table, length: float, mechanics: Mechanics | None = None) -> Tendons | None:
    """Tendons from the table [tendons] of a robot file, or None without that table.

    `radius`, `angle`, `end` and `stiffness` are numbers or lists with one a tendon, `pitch` too,
    where 0 is a straight channel.

    Args:
        robot: The file.
        length: Length of the robot, m.
        mechanics: Mechanics of the robot, if known.

    Raises:
        GlissandoError: A value is missing, impossible, or most likely in another unit.
    """
    table = robot.table("tendons")
    if table is None:
        return None
    names = tuple(table.texts("names")) if table.peek("names") is not None else ()
    listed = [table.peek(name) for name in _EACH]
    count = max([len(names), 1, *(len(value) for value in listed if isinstance(value, list))])
    given: dict[str, Any] = {name: _each(table, name, count) for name in _EACH}
    pitch = given["pitch"]
    given["pitch"] = np.where(pitch == 0.0, np.inf, pitch)
    given |= {name: table.number(name, usual) for name, usual in _SHARED.items()}
    if table.peek("learned_to") is not None:
        given["learned_to"] = learned_to = _each(table, "learned_to", count)
        if np.any((learned_to < 0.0) | (learned_to > length)):
            raise table.fail(
                "learned_to",
                f"reaches {np.max(np.abs(learned_to)):g} m on a robot of {length:g} m; give "
                f"metres, by which tendons were pulled.",
            )
    sections = None if mechanics is None else len(mechanics.stiffness)
    given |= {name: read_replicates(table, name, count, sections) for name in _OTHERS}
    table.close()
    _require_units(SimpleNamespace(**given), table.fail)
    tendons = Tendons(names=names, **given)
    off = np.flatnonzero(tendons.end > length + 1e-9)
    if off.size:
        raise table.fail(
            "end",
            f"puts tendon {off[0]} at {tendons.end[off[0]]:g} m, outside the robot of "
            f"{length:g} m; end it on the robot, in metres.",
        )
    slack = np.abs(tendons.slack).max()
    if slack > length:
        raise table.fail("slack", f"reaches {slack:g} m on {length:g} m; give metres.")
    if mechanics is not None:
        _require_stiff(table, tendons, float(mechanics.stiffness[:, 3:5].max()))
    return tendons


def _each(table: Table, name: str, count: int) -> Array:
    """Numbers (count,) of a key: one for all tendons, or a list."""
    if isinstance(table.peek(name), list):
        return table.vector(name, count, pairs=False)
    default = _OPTIONAL.get(name)
    return np.full(count, table.number(name, default, positive=name in ("radius", "stiffness")))


def _require_units(tendons: Any, fail: Callable[[str, str], Exception]) -> None:
    """Raise the error that `fail` makes for a field with implausible numbers in SI units."""
    for name in (*_EACH, *_SHARED):
        value = np.asarray(getattr(tendons, name), dtype=float)
        if np.any(np.isnan(value)) or (name != "pitch" and np.any(np.isinf(value))):
            raise fail(name, f"is {value.tolist()}; give finite numbers.")
        if name in ("radius", "end", "stiffness", *_SHARED) and np.any(value <= 0.0):
            raise fail(name, f"is {value.tolist()}; give numbers above zero.")
        if name in ("play", "friction") and np.any(value < 0.0):
            raise fail(name, f"is {value.tolist()}; give zero or more.")
    if np.any(tendons.friction > _STICKING):
        raise fail("friction", f"is {tendons.friction.tolist()}; give a coefficient, about 0.1.")
    if np.any(tendons.radius > _LARGEST_RADIUS):
        raise fail("radius", f"is {tendons.radius.tolist()}; give metres: 0.0045 for 4.5 mm.")
    if np.any(np.abs(tendons.angle) > MOST_TURNED):
        raise fail(
            "angle", f"is {tendons.angle.tolist()}; give radians, not degrees (up to a turn)."
        )
    if np.any(tendons.end > _LONGEST):
        raise fail("end", f"reaches {tendons.end.max():g} m; give metres, not millimetres.")
    if np.any(np.abs(tendons.pitch) < tendons.radius):
        raise fail("pitch", f"is {tendons.pitch.tolist()}; give metres a turn, inf if straight.")
    if np.any(np.isfinite(tendons.pitch) & (np.abs(tendons.pitch) > LONGEST_PITCH)):
        raise fail("pitch", f"is {tendons.pitch.tolist()}; give metres: 0.3 for 300 mm a turn.")
    travel = _TRAVEL * float(tendons.radius.max())
    for name in ("slack", "play", "softness", "std"):
        value = np.abs(np.asarray(getattr(tendons, name)))
        if np.any(value > (max(travel, _ZERO) if name == "slack" else travel)):
            raise fail(
                name,
                f"reaches {value.max():g} m, more than bending by {_TRAVEL:g} rad pulls a tendon "
                f"by; give metres.",
            )


def _require_stiff(table: Table, tendons: Tendons, bending: float) -> None:
    """Raise if tendons would stretch rather than bend a rod of a bending stiffness, N m²."""
    ratio = tendons.stiffness * tendons.radius**2 * tendons.end / bending
    if ratio.max() < _SOFT:
        raise table.fail(
            "stiffness",
            f"reaches {tendons.stiffness.max():g} N/m, with which tendons stretch "
            f"{1.0 / ratio.max():.2g} times as much as they bend the robot; give N/m: 1e4 for "
            f"10 N/mm.",
        )
