"""The kinematic space-time prior: white noise on the rates, exact transitions between nodes.

White noise drives ∂ϖ/∂t, ∂ε/∂s and ∂ε/∂t (equations 3 to 5). Its densities are over arclength and
time: a node's factor is weighted by the span that the node represents, so that a finer grid does
not count the prior repeatedly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from glissando._kernels import white_noise as kernels
from glissando._kernels import white_noise_points
from glissando._kernels.arrays import whole
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.field_checks import FieldChecks
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, Points
from glissando.model.priors.prior import by_interval, interval_strain, is_soft, soften
from glissando.model.priors.prior_table import (
    read_rest,
    read_segments,
    segments_table,
)
from glissando.model.priors.rest_shape import STRAIGHT, RestShape
from glissando.model.priors.static import static_factors
from glissando.model.priors.steps import ARCLENGTH, TIME, Direction, weighted_steps
from glissando.model.state import DOF, POSE, STRAIN, VELOCITY, State, rest_state
from glissando.model.table import Table, pose_table

_WOUND = 300.0  # rad of winding, above which the factor of the information has no digits left
_ALL = slice(0, DOF)


@dataclass(frozen=True)
class BaseDensity:
    """Densities of pose, strain and velocity at s = 0 by the prior; each (6,), variance · second.

    At a time node that represents Δt seconds the base has the covariance density / Δt. With a
    single time node (a static shape) Δt counts as one second, so these are plain variances.
    """

    pose: Array
    strain: Array
    velocity: Array

    def __post_init__(self) -> None:
        for name in ("pose", "strain", "velocity"):
            FieldChecks(self).numbers(name, (6,), above=0.0)


@dataclass(frozen=True)
class WhiteNoisePrior:
    """Gaussian prior on pose, strain and velocity over arclength × time.

    Densities are (6,), [linear, angular], of white noise over arclength and time:
    `psd_strain_arclength` on ∂ε/∂s and `psd_velocity_arclength` on ∂ϖ/∂s (weighted by time spans),
    `psd_velocity_time` on ∂ϖ/∂t and `psd_strain_time` on ∂ε/∂t (weighted by arclength spans).
    `rest_strain` (6,) and `base_pose` (4, 4) are the expected strain and pose at s = 0, `base`
    their densities, or None when readings fix the base. A robot of S segments has
    `psd_strain_arclength` (S, 6), the `joints` (S−1,) between them in metres, and `jumps`
    (S−1, 6), variance · second of the strain's jump there. For a robot that moves at some times
    only, `pace` (P + 1,) multiplies the densities along time before, between and after
    `pace_times` (P,), s, at the middle of a step. Source: equations (2'), (3'), (4), (5).
    """

    psd_velocity_time: Array
    psd_strain_arclength: Array
    psd_strain_time: Array
    psd_velocity_arclength: Array
    base: BaseDensity | None
    rest_strain: Array = field(default_factory=STRAIGHT.copy)
    base_pose: Array = field(default_factory=lambda: np.eye(4))
    joints: Array = field(default_factory=lambda: np.zeros(0))
    jumps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    kind: ClassVar[str] = "white-noise"
    kernels: ClassVar = "steps", "white_noise_points"
    pace: Array = field(default_factory=lambda: np.ones(1))
    pace_times: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        stated = FieldChecks(self)
        stated.segments()
        stated.rest(1)
        object.__setattr__(self, "rest_strain", self.rest_strain.reshape(6))
        for name in ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength"):
            stated.numbers(name, (6,), above=0.0)
        stated.pose("base_pose")
        if np.any(np.diff(stated.numbers("pace_times", (np.size(self.pace_times),))) <= 0.0):
            raise stated.fail("pace_times", f"is {self.pace_times.tolist()}; give rising seconds.")
        stated.numbers("pace", (self.pace_times.size + 1,), above=0.0)
        if self.base is not None and not isinstance(self.base, BaseDensity):
            raise stated.fail("base", f"is {self.base!r}; give a BaseDensity or None.")

    @classmethod
    def from_table(cls, prior: Table, robot: Table) -> WhiteNoisePrior:
        """Prior from the table [prior] of a robot file, and from the file with [base] and rest."""
        rest, psd = robot.peek("rest_strain"), ("pose", "strain", "velocity")
        rows = isinstance(rest, list) and any(isinstance(row, list) for row in rest)
        if rows or robot.peek("rest_slope") is not None:
            raise robot.fail(
                "rest_strain", 'varies along the body, which takes [prior] kind = "separable".'
            )
        names = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
        fields = read_segments(prior, "psd_jumps") | read_rest(robot, 1)
        fields |= {name: prior.vector(name, 6, positive=True) for name in names}
        if prior.peek("pace_times") is not None:
            times = prior.numbers("pace_times")
            pace = prior.vector("pace", times.size + 1, positive=True)
            fields |= {"pace": pace, "pace_times": times}
        base, densities = robot.table("base"), None
        if base is not None:
            fields["base_pose"] = base.pose()
            if any(base.peek(f"psd_{part}") is not None for part in psd):
                given = (base.vector(f"psd_{part}", 6, positive=True) for part in psd)
                densities = BaseDensity(*given)
            base.close()
        return cls(base=densities, **fields)

    def to_table(self) -> dict[str, Any]:
        """Tables of a robot file for this prior, in the form that `from_table` reads."""
        names = ("psd_velocity_time", "psd_strain_time", "psd_velocity_arclength")
        segments = self.psd_strain_arclength, self.joints, self.jumps
        prior = {"kind": self.kind, **segments_table(*segments, "psd_jumps")}
        prior |= {name: getattr(self, name).tolist() for name in names}
        if self.pace_times.size:
            prior |= {"pace": self.pace.tolist(), "pace_times": self.pace_times.tolist()}
        base = pose_table(self.base_pose)
        for part, psd in (vars(self.base) if self.base else {}).items():
            base[f"psd_{part}"] = psd.tolist()
        return {"rest_strain": self.rest_strain.tolist(), "prior": prior, "base": base}

    @property
    def rest(self) -> RestShape:
        """Shape at rest, of constant strain."""
        return RestShape(self.rest_strain[None], np.zeros((1, 6)), np.zeros(0))

    @property
    def fixes_base(self) -> bool:
        """Whether the prior alone determines the pose of the base."""
        return self.base is not None

    def least_step(self, arclength: Array) -> float:
        """Least distance of time nodes, s, at which information stays numerically accurate.

        The prior of one time node alone is the wider, the shorter the time that it represents: at
        this distance a body one standard deviation from rest would be wound by `_WOUND`.
        """
        length = float(arclength[-1] - arclength[0])
        psd = 0.5 * length * np.max(self.psd_strain_arclength[..., 3:])
        psd += 0.0 if self.base is None else np.max(self.base.strain[3:])
        return float(2.0 * psd * (length / _WOUND) ** 2)

    def with_soft_shear(self) -> WhiteNoisePrior:
        """Prior with shear and extension as soft as bending over 2 cm; itself if hardly stiffer.

        Its estimates converge more easily, so that the stiffer prior's can start from them.
        """
        names = ("psd_strain_arclength", "psd_strain_time")
        soft = {name: soften(getattr(self, name)) for name in names}
        base = self.base
        if base is not None:
            base = replace(base, strain=soften(base.strain))
        if all(is_soft(getattr(self, name), soft[name]) for name in names):
            return self
        return replace(self, **soft, base=base)

    def rest_state(self, grid: Grid) -> State:
        """State of the robot at rest on the grid, from which an estimate starts."""
        return rest_state(grid, self.base_pose, self.rest_strain)

    def retract_strains(self, grid: Grid, state: State, step: Array) -> State:
        """State after a `step` (K, N, 18), with poses that follow from the strains."""
        moved = state.retract(step)
        lengths = np.diff(grid.arclength)
        strain = interval_strain(
            moved.strain[:, :-1], moved.strain[:, 1:], lengths, self._intervals(grid.arclength)
        )
        pose = moved.pose.copy()
        for n, h in enumerate(lengths):
            pose[:, n + 1] = pose[:, n] @ se3.exp(h * strain[:, n])
        return replace(moved, pose=pose)

    def along_arclength(self, arclength: Array, at: Index) -> tuple[Array, Array, Array]:
        """Densities (M, 6) of steps from the nodes `at` (M,) of `arclength` (N,).

        They are of strain, of the carried velocity, and of the strain's jump at the end.
        """
        psd, jump = self._intervals(arclength)
        return psd[at], np.full((at.size, 6), self.psd_velocity_arclength), jump[at]

    def along_time(self, time: Array) -> tuple[Array, Array, Array]:
        """Densities (M, 6) of steps with middles at times (M,): of velocity, strain, no jump."""
        moving, carried = (
            np.full((time.size, 6), psd) for psd in (self.psd_velocity_time, self.psd_strain_time)
        )
        if self.pace_times.size:
            pace = self.pace[np.searchsorted(self.pace_times, time), None]
            moving, carried = pace * moving, pace * carried
        return moving, carried, np.zeros(moving.shape)

    def _intervals(self, arclength: Array) -> tuple[Array, Array]:
        return by_interval(arclength, self.psd_strain_arclength, self.joints, self.jumps)

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Prior factors that begin at the time nodes `times`, linearised at `state`.

        They go along arclength at each of those times, along time to the next, and to the base.
        Their weights are evaluated at the rates of `noise_state`, a state on the same grid.
        """
        k_count, n_count = grid.shape
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        nodes, flat, noise_state = node[times], state.flatten(), noise_state.flatten()
        if n_count > 1:
            ends = (nodes[:, :-1].ravel(), nodes[:, 1:].ravel())
            step = np.broadcast_to(np.diff(grid.arclength), (len(nodes), n_count - 1)).ravel()
            span = np.repeat(grid.time_spans[times], n_count - 1)
            densities = self.along_arclength(grid.arclength, ends[0] % n_count)
            yield from self._along(ARCLENGTH, flat, noise_state, ends, step, span, densities)
        if k_count > 1 and times.start < k_count - 1:
            starts = node[:-1][times]
            ends = (starts.ravel(), starts.ravel() + n_count)
            step = np.repeat(np.diff(grid.time)[times], n_count)
            span = np.broadcast_to(grid.arclength_spans, starts.shape).ravel()
            densities = self.along_time(grid.time[ends[0] // n_count] + 0.5 * step)
            yield from self._along(TIME, flat, noise_state, ends, step, span, densities)
        if self.base is not None:
            yield self._base(grid.time_spans[times], flat, nodes[:, :1])

    def static_factors(self, grid: Grid, state: State) -> Iterator[Factors]:
        """Factors of static shapes, linearised at pose and strain of nodes (S, N)."""
        base = (self.base_pose, self._base_densities[:12]) if self.base else None
        intervals = self._intervals(grid.arclength)
        yield from static_factors(grid, state, self.rest, intervals, base)

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """State at points between the nodes, conditional on the nodes. Source: (10) to (12).

        Inside a cell: along arclength at both times, then along time. Gains and bridge covariances
        are evaluated at the rates of `noise_state`, a state on the same grid, as the weights of the
        factors are; the Jacobian treats them as constant.
        """
        cells = points.along, points.through
        lower = np.stack([each.lower for each in cells], axis=1)
        places = np.array([[each.step, each.offset] for each in cells])
        fields = state.pose, state.strain, state.velocity
        pose, strain, velocity, nodes, jacobian, cov = white_noise_points.points(
            lower, whole(places.transpose(2, 0, 1)), *map(whole, fields),
            whole(noise_state.strain), whole(noise_state.velocity),
            self.arclength_densities(grid.arclength), self.time_densities(grid.time),
            grid.arclength_spans, grid.time_spans,
            (1 + points.inside_arclength) * (1 + points.inside_time),
        )  # fmt: skip
        return Interpolation(State(pose, strain, velocity), nodes, jacobian, cov)

    def arclength_densities(self, arclength: Array) -> Array:
        """Densities (N−1, 3, 6) of the steps between arclength nodes (N,).

        For each step: of the moving field, of the carried one, and the variance of a jump.
        """
        return np.stack(self.along_arclength(arclength, np.arange(arclength.size - 1)), axis=1)

    def time_densities(self, time: Array) -> Array:
        """Densities (K−1, 3, 6) of the steps between time nodes (K,)."""
        middle = 0.5 * (time[1:] + time[:-1])
        out = np.empty((middle.size, 3, 6))
        out[:, 0], out[:, 1], out[:, 2] = self.along_time(middle)
        return out

    def accumulate(
        self, grid: Grid, state: State, densities: Sequence[Array], readings: Sequence[Any],
        sums: Sequence[Array],
    ) -> tuple[Any, ...]:  # fmt: skip
        """Add the prior's factors and readings, linearised at nodes (K, N), to intervals' sums.

        Args:
            grid: Grid of the nodes.
            state: States (K, N) to linearise at, which also determine the weights.
            densities: Densities of the steps along arclength and along time.
            readings: `ReadingRows.memory`, and indices (M,) of rows of it.
            sums: Sums of a `NormalEquationsBuilder`, to which is added in place.

        Returns:
            Nodes (M, 4), Jacobians, residuals, whiteners and weights (M,) of the readings' factors.
        """
        where = grid.arclength, grid.time, grid.arclength_spans, grid.time_spans, *state.fields()
        base = self.base_pose, self.rest_strain, self._base_densities
        kernels.add_prior(*where, *densities, *base, *sums)
        linearized: tuple[Any, ...] = kernels.add_readings(*readings, *where, *densities, *sums)
        return linearized

    @cached_property
    def _base_densities(self) -> Array:
        """Densities (18,) of the base; empty if there are none."""
        return np.concatenate([np.zeros(0), *(vars(self.base).values() if self.base else ())])

    def _along(
        self,
        direction: Direction,
        flat: State,
        noise_state: State,
        ends: tuple[Index, Index],
        step: Array,
        span: Array,
        densities: tuple[Array, Array, Array],
    ) -> Iterator[Factors]:
        nodes = np.stack(ends, axis=1)
        whitened = weighted_steps(
            direction, flat, noise_state, nodes, step, np.sqrt(span), densities
        )
        for error, jacobian, info in whitened:
            yield Factors(nodes, _ALL, jacobian, Residuals(error, info))

    def _base(self, spans: Array, flat: State, nodes: Index) -> Factors:
        state = flat.take(nodes[:, 0])
        xi = se3.log(se3.inverse(self.base_pose) @ state.pose)
        residual = np.concatenate([xi, state.strain - self.rest_strain, state.velocity], axis=-1)
        jacobian = np.zeros((nodes.size, DOF, 1, DOF))
        jacobian[:, POSE, 0, POSE] = se3.right_jacobian_inverse(xi)
        jacobian[:, STRAIN, 0, STRAIN] = jacobian[:, VELOCITY, 0, VELOCITY] = np.eye(6)
        info = np.sqrt(spans)[:, None, None] * np.diag(1.0 / np.sqrt(self._base_densities))
        return Factors(nodes, _ALL, jacobian, Residuals(residual, info))
