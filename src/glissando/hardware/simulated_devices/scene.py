"""What a simulated device senses: a robot in motion, and the coils in it, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.simulation.imperfections import Imperfections
from glissando.simulation.motion import Motion

_NOISE = ("jitter", "jitter_angle", "bias", "bias_angle", "bias_length")


@dataclass(frozen=True)
class Coil:
    """A coil at `arclength` m, moved along by `direction` times the slide's travel.

    `T_bc` (4, 4) is its mount in the cross-section; its axis is its z. `port` and `channel` say
    where it is plugged in: a second coil on the same port is channel 1.
    """

    arclength: float
    direction: float
    T_bc: Array
    port: int
    channel: int = 0


@dataclass(frozen=True)
class Scene:
    """Poses `T_wb` (K, M, 4, 4) at `time` (K,) s and `arclength` (M,) m, with coils.

    Between nodes poses follow geodesics of SE(3). Time outside is held at the ends, or begins anew
    when `loop`. `T_wt` (4, 4) is the tracker in the world; of `flaws` only the tracker's noise and
    bias are used.
    """

    time: Array
    arclength: Array
    T_wb: Array
    T_wt: Array
    coils: tuple[Coil, ...]
    flaws: Imperfections
    seed: int = 0
    loop: bool = False

    def __post_init__(self) -> None:
        grid = (self.time.size, self.arclength.size, 4, 4)
        increasing = all(np.all(np.diff(x) > 0.0) for x in (self.time, self.arclength))
        if self.T_wb.shape != grid or not increasing or not min(grid):
            raise SimulationError(
                f"A scene's poses are {self.T_wb.shape} for {self.time.size} times and "
                f"{self.arclength.size} arclengths; give (times, arclengths, 4, 4), both rising."
            )
        if not all(np.all(np.isfinite(x)) for x in (self.time, self.arclength, self.T_wb)):
            raise SimulationError("A scene has numbers that are none; leave those nodes out.")

    def places(self, travel: float) -> Array:
        """Arclengths (C,) of the coils when the slide has travelled so far, m."""
        at = np.array([coil.arclength + coil.direction * travel for coil in self.coils])
        return np.clip(at, self.arclength[0], self.arclength[-1])

    def pose(self, arclength: ArrayLike, time: float) -> Array:
        """T_wb (C, 4, 4) at arclengths (C,) m and a time in s since the scene began."""
        if self.loop and self.time.size > 1:
            time = self.time[0] + (time - self.time[0]) % float(np.ptp(self.time))
        k, share = _between(self.time, np.atleast_1d(float(time)))
        n, along = _between(self.arclength, np.asarray(arclength, dtype=float))
        ends = np.stack([n, np.minimum(n + 1, self.arclength.size - 1)])
        later = np.minimum(k + 1, self.time.size - 1)
        low, high = _blend(self.T_wb[k, ends], self.T_wb[later, ends], share)
        return _blend(low, high, along)

    def coil_poses(self, time: float, travel: float) -> Array:
        """T_tc (C, 4, 4), the coils in the tracker's frame, without any error."""
        mounts = np.array([coil.T_bc for coil in self.coils])
        return se3.inverse(self.T_wt) @ self.pose(self.places(travel), time) @ mounts

    def save(self, path: Path) -> None:
        """Write the scene as NPZ."""
        np.savez(
            path,
            time=self.time,
            arclength=self.arclength,
            T_wb=self.T_wb,
            T_world_tracker=self.T_wt,
            coil_arclength=[coil.arclength for coil in self.coils],
            coil_direction=[coil.direction for coil in self.coils],
            coil_T_bc=[coil.T_bc for coil in self.coils],
            coil_port=[coil.port for coil in self.coils],
            coil_channel=[coil.channel for coil in self.coils],
            noise=[getattr(self.flaws, name) for name in _NOISE],
            roll=self.flaws.roll,
            field_size=self.flaws.field_size,
            field_centre=self.flaws.field_centre,
            seed=self.seed,
            loop=self.loop,
        )

    @staticmethod
    def load(path: Path) -> Scene:
        """Read a scene; coils, tracker, noise, seed and loop may be absent from the file.

        Raises SimulationError when it cannot be read.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                given = dict(file)
            return _scene(given)
        except (OSError, ValueError, TypeError, BadZipFile, EOFError) as problem:
            if isinstance(problem, SimulationError):
                raise
            raise SimulationError(f"Scene {path} cannot be read ({problem}).") from None
        except KeyError as missing:
            raise SimulationError(f"Scene {path} lacks {missing}; add it.") from None

    @staticmethod
    def of(
        motion: Motion,
        time: ArrayLike,
        coils: Sequence[Coil],
        *,
        nodes: int = 141,
        T_wt: Array | None = None,
        flaws: Imperfections | None = None,
        seed: int = 0,
        loop: bool = False,
    ) -> Scene:
        """The scene of a simulated motion at times (K,), with as many nodes along the robot."""
        times = np.asarray(time, dtype=float)
        places = np.linspace(0.0, motion.rod.length, nodes)
        poses = np.array([motion.at(places, t).pose for t in times])
        flaws = Imperfections(roll="minimal") if flaws is None else flaws
        frame = np.eye(4) if T_wt is None else T_wt
        return Scene(times, places, poses, frame, tuple(coils), flaws, seed, loop)


def _between(nodes: Array, at: Array) -> tuple[np.ndarray, Array]:
    """The node before, and the share of the way to the next, held at the ends."""
    if nodes.size == 1:
        return np.zeros(at.shape, dtype=int), np.zeros(at.shape)
    at = np.clip(at, nodes[0], nodes[-1])
    k = np.clip(np.searchsorted(nodes, at, "right") - 1, 0, nodes.size - 2)
    return k, (at - nodes[k]) / (nodes[k + 1] - nodes[k])


def _blend(start: Array, stop: Array, share: Array) -> Array:
    return start @ se3.exp(share[..., None] * se3.log(se3.inverse(start) @ stop))


def _scene(given: dict[str, Any]) -> Scene:
    place = np.atleast_1d(given.get("coil_arclength", np.zeros(0)))
    count = place.size
    usual = {
        "coil_direction": np.zeros(count),
        "coil_T_bc": np.tile(np.eye(4), (count, 1, 1)),
        "coil_port": np.arange(count),
        "coil_channel": np.zeros(count, dtype=int),
    }
    columns = [np.asarray(given.get(name, default)) for name, default in usual.items()]
    direction, mount, port, channel = columns
    coils = tuple(
        Coil(float(place[k]), float(direction[k]), mount[k], int(port[k]), int(channel[k]))
        for k in range(count)
    )
    known = dict(zip(_NOISE, given.get("noise", ()), strict=False))
    known |= {key: given[key] for key in ("field_size", "field_centre") if key in given}
    floats = {f.name for f in fields(Imperfections) if f.type == "float"}
    noise: dict[str, Any] = {k: float(v) if k in floats else v for k, v in known.items()}
    grid = [np.asarray(given[name], dtype=float) for name in ("time", "arclength", "T_wb")]
    return Scene(
        grid[0],
        grid[1],
        grid[2],
        np.asarray(given.get("T_world_tracker", np.eye(4)), dtype=float),
        coils,
        Imperfections(**noise, roll=str(given.get("roll", "minimal"))),
        int(given.get("seed", 0)),
        bool(given.get("loop", False)),
    )
