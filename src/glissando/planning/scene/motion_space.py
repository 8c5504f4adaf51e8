"""The motions that tendons and slides can make: B-splines within the limits of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.optimize import Polytope
from glissando.planning.path_space import PathSpace
from glissando.planning.scene.scene import Actuator, Scene


@dataclass(frozen=True)
class MotionSpace:
    """The motions that actuators can make: paths of C actuators, all of the same times.

    Attributes:
        paths: The paths of each.
        moments: Times (K,) at which a motion is judged, s from its start.
    """

    paths: tuple[PathSpace, ...]
    moments: Array

    @property
    def size(self) -> int:
        """Free numbers of a motion."""
        return len(self.paths) * (self.paths[0].steps - 1)

    @cached_property
    def scale(self) -> Array:
        """Half the range (C, 1) of each actuator, by which free numbers are divided, m."""
        return np.array([[0.5 * (path.upper - path.lower)] for path in self.paths])

    @cached_property
    def basis(self) -> Array:
        """Values (K, S+2) of the splines of each control point at the moments."""
        path = self.paths[0]
        piece = np.minimum((self.moments / path.step).astype(np.intp), path.steps - 1)
        x = self.moments / path.step - piece
        out = np.zeros((self.moments.size, path.steps + 2))
        parts = 0.5 * (1.0 - x) ** 2, 0.5 + x - x**2, 0.5 * x**2
        for shift, part in enumerate(parts):
            out[np.arange(x.size), piece + shift] = part
        return out

    def moment_at(self, time: float) -> int:
        """Number of the last moment that is not after a time, s."""
        return max(0, int(np.searchsorted(self.moments, time + 1e-9, side="right")) - 1)

    def control(self, free: Array) -> Array:
        """Control points (C, S+2) of a motion with free numbers (n,), m."""
        own = free.reshape(len(self.paths), -1) * self.scale
        return np.stack([path.control(row) for path, row in zip(self.paths, own, strict=True)])

    def free(self, control: Array) -> Array:
        """The free numbers (n,) of a motion with control points (C, S+2)."""
        return np.asarray((control[:, 2:-1] / self.scale).ravel())

    def free_gradient(self, by_value: Array, by_control: Array) -> Array:
        """Slope (n,) by the free numbers of slopes at the moments (K, C) and by control points."""
        total = by_value.T @ self.basis + by_control
        own = total[:, 2:-1].copy()
        own[:, -1] += total[:, -1]
        return np.asarray((own * self.scale).ravel())

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest free numbers (n,)."""
        ends = np.array([[path.lower, path.upper] for path in self.paths]) / self.scale
        low, high = np.repeat(ends, self.paths[0].steps - 1, axis=0).T
        return low, high

    @cached_property
    def polytope(self) -> Polytope:
        """The limits of all paths on the free numbers."""
        n = self.paths[0].steps - 1
        blocks, centres, widths = [], [], []
        for c, (path, scale) in enumerate(zip(self.paths, self.scale, strict=True)):
            rows, centre, width = path.polytope
            wide = np.zeros((len(rows), self.size))
            wide[:, c * n : (c + 1) * n] = rows * scale
            blocks.append(wide)
            centres.append(centre)
            widths.append(width)
        return np.concatenate(blocks), np.concatenate(centres), np.concatenate(widths)

    def follow(self, target: Array) -> Array:
        """Control points (C, S+2) as near to targets (C, S+2) as the limits allow."""
        return np.stack([path.follow(row) for path, row in zip(self.paths, target, strict=True)])


def motion_space(
    scene: Scene, step: float = 1.0, moment: float = 0.5,
    start: Array | None = None, speed: Array | None = None,
) -> MotionSpace:  # fmt: skip
    """The motions of a scene's tendons and slides; tendons keep reserves to correct.

    Args:
        scene: The scene.
        step: Duration of a piece of the splines, s.
        moment: Least time between moments at which a motion is judged, s: readings count no sooner
            than they correct commands.
        start: Where the actuators (C,) are; where the scene starts unless given.
        speed: Their speeds (C,); at rest unless given.

    Raises:
        GlissandoError: An actuator cannot stop within its limits.
    """
    steps = max(2, round(scene.horizon / step))
    step = scene.horizon / steps
    intervals = max(1, int(scene.horizon / moment + 1e-9))
    actuators: list[Actuator] = [*scene.tendons, *scene.slides]
    places = np.array([a.start for a in actuators]) if start is None else start
    for k, tendon in enumerate(scene.tendons):
        low, high = tendon.lower + scene.stroke_reserve, tendon.upper - scene.stroke_reserve
        low, high = min(low, float(places[k])), max(high, float(places[k]))
        speed_left = (1.0 - scene.reserve) * tendon.speed
        actuators[k] = replace(tendon, lower=low, upper=high, speed=speed_left)
    speeds = np.zeros(len(actuators)) if speed is None else speed
    paths = tuple(
        PathSpace(a.lower, a.upper, a.speed, a.acceleration, step, steps, float(p), float(v))
        for a, p, v in zip(actuators, places, speeds, strict=True)
    )
    return MotionSpace(paths, np.linspace(0.0, scene.horizon, intervals + 1))
