"""Space of the motions of tendons and slides: B-splines within the limits of each actuator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.planning.optimize import Polytope
from glissando.planning.path_space import PathSpace
from glissando.planning.scene.scene import Actuator, Scene

_SAME = 1e-9  # s, below which two times are equal


@dataclass(frozen=True)
class MotionSpace:
    """Motions of C actuators: paths over the same time steps.

    Attributes:
        paths: Space of paths of each actuator.
        moments: Times (K,) at which a motion is evaluated, s from its start.
        corrected: Indices (M,) of the moments at which commands are corrected by readings: the
            first, the last, and evenly spaced ones between.
    """

    paths: tuple[PathSpace, ...]
    moments: Array
    corrected: Index

    @property
    def size(self) -> int:
        """Number n of free variables of a motion."""
        return len(self.paths) * (self.paths[0].steps - 1)

    @cached_property
    def scale(self) -> Array:
        """Half the range (C, 1) of each actuator, m, the unit of its free variables."""
        return np.array([[0.5 * (path.upper - path.lower)] for path in self.paths])

    @cached_property
    def basis(self) -> Array:
        """Basis functions (K, S+2) of the control points at the moments."""
        return self.basis_at(self.moments)

    def basis_at(self, time: Array) -> Array:
        """Basis functions (L, S+2) of the control points at times (L,), s."""
        path = self.paths[0]
        piece = np.minimum((time / path.step).astype(np.intp), path.steps - 1)
        x = time / path.step - piece
        out = np.zeros((time.size, path.steps + 2))
        parts = 0.5 * (1.0 - x) ** 2, 0.5 + x - x**2, 0.5 * x**2
        for shift, part in enumerate(parts):
            out[np.arange(x.size), piece + shift] = part
        return out

    @property
    def correction(self) -> float:
        """Time from one correction to the next, s."""
        return float(self.moments[self.corrected[1]])

    @cached_property
    def position(self) -> Array:
        """The moments (K,) in units of correction intervals, 0 to M − 1."""
        position = self.moments / self.correction
        position[self.corrected] = np.arange(self.corrected.size)
        return position

    def with_moments(self, time: Array) -> MotionSpace:
        """The same motions, evaluated at further times (L,), s, as well."""
        apart = np.abs(time[:, None] - self.moments).min(axis=1)
        moments = np.sort(np.concatenate([self.moments, time[apart > _SAME]]))
        corrected = np.searchsorted(moments, self.moments[self.corrected])
        return replace(self, moments=moments, corrected=corrected)

    def moment_at(self, time: float) -> int:
        """Index of the last moment that is not after a time, s."""
        return max(0, int(np.searchsorted(self.moments, time + _SAME, side="right")) - 1)

    def control(self, free: Array) -> Array:
        """Control points (C, S+2), m, of a motion with free variables (n,)."""
        own = free.reshape(len(self.paths), -1) * self.scale
        return np.stack([path.control(row) for path, row in zip(self.paths, own, strict=True)])

    def free(self, control: Array) -> Array:
        """Free variables (n,) of a motion with control points (C, S+2), m."""
        return np.asarray((control[:, 2:-1] / self.scale).ravel())

    def free_gradient(self, by_value: Array, by_control: Array) -> Array:
        """Gradient (n,) by the free variables, from those by values (K, C) and control points."""
        total = by_value.T @ self.basis + by_control
        own = total[:, 2:-1].copy()
        own[:, -1] += total[:, -1]
        return np.asarray((own * self.scale).ravel())

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (n,) of the free variables."""
        ends = np.array([[path.lower, path.upper] for path in self.paths]) / self.scale
        low, high = np.repeat(ends, self.paths[0].steps - 1, axis=0).T
        return low, high

    @cached_property
    def polytope(self) -> Polytope:
        """Limits of all paths, as a polytope of the free variables."""
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
        """Control points (C, S+2) that follow targets (C, S+2) as closely as the limits allow."""
        return np.stack([path.follow(row) for path, row in zip(self.paths, target, strict=True)])


def motion_space(
    scene: Scene, step: float = 1.0, start: Array | None = None, speed: Array | None = None
) -> MotionSpace:  # fmt: skip
    """Space of the motions of a scene's tendons and slides.

    The tendons' limits exclude the reserves for corrections. Motions are evaluated at each
    correction of the commands and at the time of each target.

    Args:
        scene: The scene.
        step: Approximate duration of a piece of the splines, s.
        start: Initial values (C,) of the actuators, m; by default the scene's.
        speed: Initial speeds (C,), m/s; by default zero.

    Raises:
        GlissandoError: An actuator cannot stop within its limits.
    """
    steps = max(2, round(scene.horizon / step))
    step = scene.horizon / steps
    intervals = max(1, int(scene.horizon / scene.correction + _SAME))  # not shorter than the loop's
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
    moments = np.linspace(0.0, scene.horizon, intervals + 1)
    space = MotionSpace(paths, moments, np.arange(moments.size))
    return space.with_moments(np.array([target.time for target in scene.targets]))
