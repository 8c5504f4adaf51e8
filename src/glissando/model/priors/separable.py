"""The separable space-time prior: every arclength interval is a stationary process in time.

The error of an interval (equation 2') is a Gaussian process in time with covariance k(t−t') Q, k a
Matérn-3/2 of unit variance, and so are base pose and base strain. The process is defined on the
continuum, so that neither more nodes nor a longer recording changes it. Nodes have a strain rate,
24 numbers each. Source: equations (6) to (9).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from glissando._kernels import stationary as kernels
from glissando._kernels.arrays import whole
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.field_checks import FieldChecks
from glissando.model.grid import Cells, Grid, Index
from glissando.model.priors.intervals import (
    interval_between,
    interval_end,
    interval_error,
    place_error,
)
from glissando.model.priors.prior import (
    by_interval,
    interval_strain,
    is_soft,
    soften,
    transversely_isotropic,
)
from glissando.model.priors.prior_table import (
    read_rest,
    read_segments,
    segments_table,
)
from glissando.model.priors.rest_shape import STRAIGHT, RestShape
from glissando.model.priors.static import static_factors
from glissando.model.priors.stationary import StationaryPrior, chain_factors, longest_scale
from glissando.model.priors.transitions import bridge, process_covariances
from glissando.model.state import POSE, STRAIN, State
from glissando.model.table import Table, pose_table

_NEGLIGIBLE = 1e-30  # factor on densities whose ratios alone matter


@dataclass(frozen=True)
class BaseVariance:
    """Variances of pose and strain at s = 0 about their expected values; each (6,)."""

    pose: Array
    strain: Array

    def __post_init__(self) -> None:
        for name in ("pose", "strain"):
            FieldChecks(self).numbers(name, (6,), above=0.0)


@dataclass(frozen=True)
class SeparablePrior(StationaryPrior):
    """Gaussian process on pose and strain over arclength × time.

    `psd_strain_arclength` (6,) is the density of white noise on ∂ε/∂s at any one time, a strain
    variance per metre; `time_scale` ℓ is the correlation time of shapes in seconds; `base` holds
    the variances of pose and strain at s = 0 about `base_pose` (4, 4) and `rest_strain` (6,). A
    robot of S segments has densities (S, 6), the `joints` (S−1,) between them in metres, and
    `jumps` (S−1, 6), variances of the strain's jump there; it may be curved at rest, with the
    strain `rest_strain` (S, 6) where each segment begins and its change per metre `rest_slope`
    (S, 6). The pose of a clamped base is uncertain but constant: `base_time_scale`, in seconds, is
    its longer correlation time, of at least ℓ and at most 200 time steps.
    Source: equations (6) to (9).
    """

    psd_strain_arclength: Array
    time_scale: float
    base: BaseVariance
    rest_strain: Array = field(default_factory=STRAIGHT.copy)
    base_pose: Array = field(default_factory=lambda: np.eye(4))
    joints: Array = field(default_factory=lambda: np.zeros(0))
    jumps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    rest_slope: Array = field(default_factory=lambda: np.zeros(6))
    base_time_scale: float | None = None
    kind: ClassVar[str] = "separable"
    kernels: ClassVar = "intervals", "matern", "stationary", "transitions"

    def __post_init__(self) -> None:
        stated = FieldChecks(self)
        stated.rest(stated.segments())
        stated.numbers("rest_slope", (6,), (self.joints.size + 1, 6))
        stated.pose("base_pose")
        stated.number("time_scale", above=0.0)
        if self.base_time_scale is not None:
            stated.number("base_time_scale", above=0.0)
        if not isinstance(self.base, BaseVariance):
            raise stated.fail("base", f"is {self.base!r}; give a BaseVariance.")

    @classmethod
    def from_table(cls, prior: Table, robot: Table) -> SeparablePrior:
        """Prior from the table [prior] of a robot file, and from the file with [base] and rest."""
        fields = read_segments(prior, "var_jumps")
        fields |= read_rest(robot, 1 + fields["joints"].size if "joints" in fields else 1)
        base = robot.subtable("base")
        fields["base_pose"] = base.pose()
        parts = (base.vector(f"var_{part}", 6, positive=True) for part in ("pose", "strain"))
        variance = BaseVariance(*parts)
        own = None if base.peek("time_scale") is None else base.number("time_scale")
        base.close()
        shape = cls(time_scale=prior.number("time_scale"), base=variance, **fields)  # type: ignore[arg-type]
        return replace(shape, base_time_scale=own)

    def to_table(self) -> dict[str, Any]:
        """Tables of a robot file for this prior, in the form that `from_table` reads."""
        segments = self.psd_strain_arclength, self.joints, self.jumps
        prior = {"kind": self.kind, "time_scale": float(self.time_scale)}
        base = pose_table(self.base_pose)
        base |= {f"var_{part}": variance.tolist() for part, variance in vars(self.base).items()}
        if self.base_time_scale is not None:
            base["time_scale"] = float(self.base_time_scale)
        rest = {key: getattr(self, key).tolist() for key in ("rest_strain", "rest_slope")}
        return {**rest, "prior": prior | segments_table(*segments, "var_jumps"), "base": base}

    @property
    def rest(self) -> RestShape:
        """The shape at rest."""
        return RestShape.of_segments(self.rest_strain, self.rest_slope, self.joints)

    def with_soft_shear(self) -> SeparablePrior:
        """Prior with shear and extension as soft as bending over 2 cm; itself if hardly stiffer."""
        psd = soften(self.psd_strain_arclength)
        if is_soft(self.psd_strain_arclength, psd):
            return self
        base = replace(self.base, strain=soften(self.base.strain))
        return replace(self, psd_strain_arclength=psd, base=base)

    def on(self, grid: Grid) -> SeparablePrior:
        """Prior as its factors on a grid use it: dense time nodes limit the base's time scale.

        Args:
            grid: The grid.
        """
        if self.base_time_scale is None:
            return self
        scale = max(self.time_scale, min(self.base_time_scale, longest_scale(grid)))
        return replace(self, base_time_scale=scale)

    def rest_state(self, grid: Grid) -> State:
        """State of the robot at rest on the grid, from which an estimate starts."""
        rest, still = self.rest, np.zeros((*grid.shape, 6))
        pose = np.broadcast_to(rest.poses(self.base_pose, grid.arclength), (*grid.shape, 4, 4))
        strain = np.broadcast_to(rest.at(grid.arclength), still.shape)
        return State(pose.copy(), strain.copy(), still, still.copy())

    def retract_strains(self, grid: Grid, state: State, step: Array) -> State:
        """State after a `step` (K, N, 24), built interval by interval from the base outwards.

        The errors of intervals change by the step to first order, so that poses and strains stay
        consistent however long it is.
        """
        moved = [state.take(np.s_[:, 0]).retract(step[:, 0])]
        for n, h in enumerate(np.diff(grid.arclength)):
            ends = state.take(np.s_[:, n]), state.take(np.s_[:, n + 1])
            lengths = np.full(len(step), h)
            error, j0, j1 = interval_error(*ends, lengths)
            change = (j0 @ step[:, n, :, None] + j1 @ step[:, n + 1, :, None])[..., 0]
            moved.append(interval_end(moved[-1], error + change, lengths))
        fields = zip(*(node.fields() for node in moved), strict=True)
        return State(*(np.stack(field, axis=1) for field in fields))

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors that begin at the time nodes `times`, linearised at `state`.

        They are of every interval and the base, at the first time and from each of `times` on.
        """
        k_count, n_count = grid.shape
        self.require_digits(grid)
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        touched = slice(times.start, min(times.stop + 1, k_count))
        nodes, steps = node[touched], np.diff(grid.time[touched])
        local = state.take(touched)
        first = times.start == 0 and grid.before is None
        base = self._base(local)
        scale = self.on(grid).base_time_scale
        if scale is None:
            yield from chain_factors(self.time_scale, first, steps, nodes[:, :1, None], *base)
        else:
            yield from self._split_base_factors(scale, first, steps, nodes[:, :1, None], *base)
        if n_count == 1:
            return
        ends = local.take(np.s_[:, :-1]), local.take(np.s_[:, 1:])
        step = np.broadcast_to(np.diff(grid.arclength), (len(nodes), n_count - 1))
        error, *jacobians = interval_error(*ends, step)
        error[..., :12] -= self.rest.interval_errors(grid.arclength)
        about = noise_state.take(touched)
        cov = self._interval_covariances(grid, about)[1]
        isotropic = transversely_isotropic(self.psd_strain_arclength, self.jumps)
        angle = ends[0].rolls_from(about.take(np.s_[:, :-1])) if isotropic else None
        yield from chain_factors(
            self.time_scale,
            first,
            steps,
            np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2),
            error,
            np.stack(jacobians, axis=3),
            cov,
            angle=angle,
        )

    def _split_base_factors(
        self,
        pose_scale: float,
        first: bool,
        steps: Array,
        nodes: Index,
        error: Array,
        jacobian: Array,
        cov: Array,
    ) -> Iterator[Factors]:
        """Factors of a base whose pose has a longer time scale than its strain."""
        for scale, part in ((pose_scale, POSE), (self.time_scale, STRAIN)):
            rows = np.r_[part, part.start + 12 : part.stop + 12]
            parts = error[..., rows], jacobian[..., rows, :, :], cov[..., part, part]
            yield from chain_factors(scale, first, steps, nodes, *parts, paired=False)

    def _base(self, state: State) -> tuple[Array, Array, Array]:
        """Error [r; ṙ] (K, 1, 24) of the base, its Jacobian (K, 1, 24, 1, 24), and covariance."""
        at = state.take(np.s_[:, :1])
        error, jacobian = place_error(self.base_pose, self.rest.at(np.zeros(1)), at)
        cov = np.broadcast_to(np.diag(self._base_variance), (*error.shape[:2], 12, 12))
        return error, jacobian[..., None, :], cov

    @property
    def _base_variance(self) -> Array:
        """Variances (12,) of the base's pose and strain."""
        return np.concatenate([self.base.pose, self.base.strain])

    def _interval_covariances(self, grid: Grid, noise_state: State) -> tuple[Array, Array]:
        """Strains (K, N−1, 6) about which intervals are linearised, and Q (K, N−1, 12, 12)."""
        psd, jump = self._intervals(grid)
        lengths = np.diff(grid.arclength)
        strain = interval_strain(
            noise_state.strain[:, :-1], noise_state.strain[:, 1:], lengths, (psd, jump)
        )
        step = np.broadcast_to(lengths, strain.shape[:2])
        return strain, process_covariances(strain, step, psd, psd, rigid=False, jump=jump)[0]

    def _intervals(self, grid: Grid) -> tuple[Array, Array]:
        return by_interval(grid.arclength, self.psd_strain_arclength, self.joints, self.jumps)

    def static_factors(self, grid: Grid, state: State) -> Iterator[Factors]:
        """Factors of static shapes, linearised at pose and strain of nodes (S, N)."""
        base = self.base_pose, self._base_variance
        yield from static_factors(grid, state, self.rest, self._intervals(grid), base)

    def between(
        self, grid: Grid, start: State, end: State, k: Index, s: Cells, gain: Array
    ) -> tuple[State, Array]:
        """State (M,) inside intervals `s` at time nodes k, Jacobian (M, 24, 2, 24) by both ends."""
        within = s.step, s.offset, gain, self._rest_within(grid, s)
        at, *jacobians = interval_between(start, end, *within)
        return at, np.stack(jacobians, axis=2)

    def arclength_bridge(
        self, grid: Grid, noise_state: State, k: Index, s: Cells
    ) -> tuple[Array, Array]:
        """Gain and covariance (M, 12, 12) inside the intervals `s` at time nodes k."""
        psd, jump = (values[s.lower] for values in self._intervals(grid))
        ends = noise_state.strain[k, s.lower], noise_state.strain[k, s.lower + 1]
        rate = interval_strain(*ends, s.step, (psd, jump))
        return bridge(rate, s.step, s.offset, psd, jump)

    def _rest_within(self, grid: Grid, s: Cells) -> tuple[Array, Array]:
        """Errors (M, 12) at rest of the intervals `s`, and of their parts up to the points."""
        whole = self.rest.interval_errors(grid.arclength)[np.minimum(s.lower, grid.shape[1] - 2)]
        return whole, self.rest.error(grid.arclength[s.lower], s.offset)

    def sections(
        self, grid: Grid, noise_state: State, k: Index, n: Index, s: Cells, inside: bool
    ) -> list[tuple[float, Array]]:
        """Prior covariances K_s (M, 12, 12) of pose and strain along the shapes at time nodes k.

        A base with its own time scale adds a term: a motion of the whole body without strain.
        """
        zeros, parts = np.zeros(6), [(self.time_scale, (self.base.pose, self.base.strain), 1.0)]
        base_scale = self.on(grid).base_time_scale
        if base_scale is not None:
            parts = [(self.time_scale, (zeros, self.base.strain), 1.0)]
            parts.append((base_scale, (self.base.pose, zeros), _NEGLIGIBLE))
        psd, jump = map(whole, self._intervals(grid))
        at = whole(k), whole(n), whole(s.offset if inside else np.zeros(k.size))
        strain, lengths = whole(noise_state.strain), np.diff(grid.arclength)
        return [
            (scale, kernels.sections(strain, lengths, share * psd, share * jump, base, *at))
            for scale, variances, share in parts
            for base in [np.diag(np.concatenate(variances))]
        ]
