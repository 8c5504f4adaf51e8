"""Scene of simulated devices: a robot in motion and its coils, stored in one file."""

from __future__ import annotations

import json
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
from glissando.io.atomic import new_file
from glissando.model.tendons.channel import Channel
from glissando.simulation.imperfections import Imperfections
from glissando.simulation.motion import Motion
from glissando.simulation.rod import Tendon

_NODES = 141  # arclengths of a scene made from a motion


@dataclass(frozen=True)
class SceneCoil:
    """A coil of a simulated tracker.

    Attributes:
        arclength: Arclength when the travel is zero, m.
        direction: Change of its arclength per travel of the slide.
        T_bc: Pose in the cross-section (4, 4); the axis of the coil is its z.
        port: Index of the port that it is plugged in at.
        channel: 1 for the second coil at a port, else 0.
        way: Table of the channel beside the backbone in which it slides, along which its arclength
            is then measured; None for a coil on the backbone.
    """

    arclength: float
    direction: float
    T_bc: Array
    port: int
    channel: int = 0
    way: dict[str, float] | None = None


@dataclass(frozen=True)
class Scene:
    """A robot in motion, interpolated geodesically between nodes, at rest before and after.

    Attributes:
        time: Times (K,), s.
        arclength: Arclengths (M,), m.
        T_wb: Poses (K, M, 4, 4) of the cross-sections in the world frame.
        T_wt: Pose of the tracker in the world frame (4, 4).
        coils: Coils of the tracker.
        flaws: Noise and bias of the tracker; the other imperfections have no effect.
        seed: Seed of the noise.
    """

    time: Array
    arclength: Array
    T_wb: Array
    T_wt: Array
    coils: tuple[SceneCoil, ...]
    flaws: Imperfections
    seed: int = 0

    def __post_init__(self) -> None:
        grid = (self.time.size, self.arclength.size, 4, 4)
        increasing = all(np.all(np.diff(x) > 0.0) for x in (self.time, self.arclength))
        if self.T_wb.shape != grid or not increasing or not min(grid):
            raise SimulationError(
                f"A scene's poses are {self.T_wb.shape} for {self.time.size} times and "
                f"{self.arclength.size} arclengths; give (times, arclengths, 4, 4), both rising."
            )
        if not all(np.all(np.isfinite(x)) for x in (self.time, self.arclength, self.T_wb)):
            raise SimulationError("A scene has numbers that are not finite; leave those nodes out.")

    def pose(self, arclength: ArrayLike, time: float) -> Array:
        """T_wb (C, 4, 4) at arclengths (C,) m and a time of the scene, s."""
        k, share = _between(self.time, np.atleast_1d(float(time)))
        n, along = _between(self.arclength, np.asarray(arclength, dtype=float))
        ends = np.stack([n, np.minimum(n + 1, self.arclength.size - 1)])
        later = np.minimum(k + 1, self.time.size - 1)
        low, high = _blend(self.T_wb[k, ends], self.T_wb[later, ends], share)
        return _blend(low, high, along)

    def coil_poses(self, time: float, travel: float) -> Array:
        """T_tc (C, 4, 4) of the coils at a time of the scene, s, and a travel, m, without error."""
        at = np.array([coil.arclength + coil.direction * travel for coil in self.coils])
        mounts = np.array([coil.T_bc for coil in self.coils])
        poses = np.empty((len(at), 4, 4))
        for k, (coil, place) in enumerate(zip(self.coils, at, strict=True)):
            pose = self.pose(np.array([place]), time)[0]
            poses[k] = self._beside(coil.way, place, time) if coil.way else pose
        return se3.inverse(self.T_wt) @ poses @ mounts

    def _beside(self, way: dict[str, float], travel: float, time: float) -> Array:
        """T_wc (4, 4) at a length in m along a channel, interpolated between its nodes."""
        stated = Channel(way["radius"], way["angle"], way["pitch"] or np.inf)
        channel = Tendon.in_channel(stated, float(self.arclength[-1]))
        bodies, place = self.pose(self.arclength, time), channel.path(self.arclength)[0]
        path = bodies[:, :3, 3] + np.einsum("nij,nj->ni", bodies[:, :3, :3], place)
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        lengths = np.append(0.0, np.cumsum(steps))
        inside = float(np.clip(travel, 0.0, lengths[-1]))
        at = np.array([np.interp(inside, lengths, self.arclength)])
        slopes = np.gradient(path, lengths, axis=0, edge_order=2).T
        along = np.array([np.interp(inside, lengths, x) for x in slopes])
        out = self.pose(at, time)[0]
        axis = out[:3, :3].T @ (along / np.linalg.norm(along))
        position = channel.path(at)[0][0] + (travel - inside) * axis
        return np.asarray(out @ se3.pose(se3.least_turn(axis[None])[0], position))

    def save(self, path: Path) -> None:
        """Write the scene as NPZ: time, arclength, T_wb, and the rest as JSON."""
        device = {
            "T_wt": self.T_wt.tolist(),
            "coils": [{**vars(coil), "T_bc": coil.T_bc.tolist()} for coil in self.coils],
            "flaws": {
                f.name: np.asarray(getattr(self.flaws, f.name)).tolist() for f in fields(self.flaws)
            },
            "seed": self.seed,
        }
        everything_else = json.dumps(device)
        time, arclength, T_wb = self.time, self.arclength, self.T_wb
        with new_file(path) as building:
            np.savez(building, time=time, arclength=arclength, T_wb=T_wb, device=everything_else)

    @staticmethod
    def load(path: Path) -> Scene:
        """Read a scene; a file with only time, arclength and T_wb has no coils.

        Raises:
            SimulationError: The file cannot be read, or is not a scene.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                time, arclength, T_wb = (
                    np.asarray(file[name], dtype=float) for name in ("time", "arclength", "T_wb")
                )
                device = json.loads(str(file["device"])) if "device" in file else {}
        except (OSError, ValueError, KeyError, BadZipFile, EOFError) as problem:
            raise SimulationError(
                f"Scene {path} cannot be read ({problem}); give an NPZ file with time, arclength "
                f"and T_wb."
            ) from None
        flaws: dict[str, Any] = {
            name: np.array(value) if isinstance(value, list) else value
            for name, value in device.get("flaws", {"roll": "minimal"}).items()
        }
        coils = (SceneCoil(**(c | {"T_bc": np.array(c["T_bc"])})) for c in device.get("coils", ()))
        T_wt = np.array(device.get("T_wt", np.eye(4)))
        seed = device.get("seed", 0)
        return Scene(time, arclength, T_wb, T_wt, tuple(coils), Imperfections(**flaws), seed)

    @staticmethod
    def of(
        motion: Motion,
        time: ArrayLike,
        coils: Sequence[SceneCoil],
        *,
        T_wt: Array | None = None,
        flaws: Imperfections | None = None,
        seed: int = 0,
    ) -> Scene:
        """Sample a simulated motion as a scene.

        Args:
            motion: The robot's motion.
            time: Times (K,) at which shapes are sampled, s.
            coils: Coils of the tracker.
            T_wt: Pose of the tracker in the world frame (4, 4); identity if None.
            flaws: Noise and bias of the tracker; the usual ones if None.
            seed: Seed of the noise.
        """
        times = np.asarray(time, dtype=float)
        places = np.linspace(0.0, motion.rod.length, _NODES)
        poses = np.array([motion.at(places, t).pose for t in times])
        flaws = Imperfections(roll="minimal") if flaws is None else flaws
        frame = np.eye(4) if T_wt is None else T_wt
        return Scene(times, places, poses, frame, tuple(coils), flaws, seed)


def _between(nodes: Array, at: Array) -> tuple[np.ndarray, Array]:
    """Index of the node before, and fraction of the interval after it; clamped at both ends."""
    if nodes.size == 1:
        return np.zeros(at.shape, dtype=int), np.zeros(at.shape)
    at = np.clip(at, nodes[0], nodes[-1])
    k = np.clip(np.searchsorted(nodes, at, "right") - 1, 0, nodes.size - 2)
    return k, (at - nodes[k]) / (nodes[k + 1] - nodes[k])


def _blend(start: Array, stop: Array, share: Array) -> Array:
    return start @ se3.exp(share[..., None] * se3.log(se3.inverse(start) @ stop))
