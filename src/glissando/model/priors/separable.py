"""The separable space-time prior: every arclength interval is a stationary process in time.

The error of an interval (equation 2') is a Gaussian process in time with covariance k(t−t') Q, k a
Matérn-3/2 of unit variance, and so are base pose and base strain. It is one process over the plane:
neither more nodes nor a longer recording changes what it says. Nodes know their strain rate, 24
numbers each. Source: equations (6) to (9).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from glissando.errors import OutsideGridError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Cells, Grid, Index
from glissando.model.interpolation import Interpolation, Points, chained
from glissando.model.noise import pair_sqrt_information
from glissando.model.priors import matern
from glissando.model.priors.intervals import (
    RATED,
    at_time_nodes,
    interval_end,
    interval_error,
    kron_pair,
    place_error,
    strain_rate_of,
)
from glissando.model.priors.prior import by_interval, interval_strain, is_soft, soften
from glissando.model.priors.prior_table import (
    PriorTable,
    pose_table,
    read_rest,
    read_segments,
    segments_table,
)
from glissando.model.priors.rest_shape import STRAIGHT, RestShape
from glissando.model.priors.static import static_factors
from glissando.model.priors.steps import TIME, pair_between
from glissando.model.priors.transitions import bridge, process_covariances, transition
from glissando.model.state import DOF, POSE, STRAIN, STRAIN_RATE, VELOCITY, State

_ALL = slice(0, RATED)
_DENSEST = 200.0  # time nodes a time scale: beyond, rounding shows in the covariance


@dataclass(frozen=True)
class BaseVariance:
    """How much pose and strain at s = 0 vary about where the robot stands and rests; each (6,)."""

    pose: Array
    strain: Array


@dataclass(frozen=True)
class SeparablePrior:
    """Gaussian process on pose and strain over arclength × time.

    `psd_strain_arclength` (6,) is the density of white noise on ∂ε/∂s at any one time, a strain
    variance per metre; `time_scale` ℓ in seconds is how long a shape is remembered; `base` says how
    far pose and strain at s = 0 stray from `base_pose` (4, 4) and `rest_strain` (6,). A robot of S
    segments gives densities (S, 6), the `joints` (S−1,) between them in metres, and `jumps`
    (S−1, 6), variances of the strain's jump there; it may be curved at rest, with the strain
    `rest_strain` (S, 6) where each segment begins and its change per metre `rest_slope` (S, 6).
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
    kind: ClassVar[str] = "separable"

    @classmethod
    def from_table(cls, prior: PriorTable, robot: PriorTable) -> SeparablePrior:
        """The prior of a robot file, from its [prior] table and the file with [base] and rest."""
        fields = read_segments(prior, "var_jumps")
        fields |= read_rest(robot, 1 + fields["joints"].size if "joints" in fields else 1)
        base = robot.table("base", required=True)
        assert base is not None
        fields["base_pose"] = base.pose()
        parts = (base.vector(f"var_{part}", 6, positive=True) for part in ("pose", "strain"))
        variance = BaseVariance(*parts)
        base.close()
        return cls(time_scale=prior.number("time_scale"), base=variance, **fields)

    def to_table(self) -> dict[str, Any]:
        """What a robot file says of this prior, as `from_table` reads it."""
        segments = self.psd_strain_arclength, self.joints, self.jumps
        prior = {"kind": self.kind, "time_scale": float(self.time_scale)}
        base = pose_table(self.base_pose)
        base |= {f"var_{part}": variance.tolist() for part, variance in vars(self.base).items()}
        rest = {key: getattr(self, key).tolist() for key in ("rest_strain", "rest_slope")}
        return {**rest, "prior": prior | segments_table(*segments, "var_jumps"), "base": base}

    @property
    def rest(self) -> RestShape:
        """The shape at rest."""
        given = np.atleast_2d(self.rest_strain), np.atleast_2d(self.rest_slope)
        strain, slope = np.broadcast_arrays(*given)
        return RestShape(strain, slope, self.joints if len(strain) > 1 else np.zeros(0))

    @property
    def fixes_base(self) -> bool:
        """True: a stationary process strays only so far from where it is expected."""
        return True

    def softened(self) -> SeparablePrior:
        """The prior with shear and extension as soft as bending over 2 cm, or itself if not far."""
        psd = soften(self.psd_strain_arclength)
        if is_soft(self.psd_strain_arclength, psd):
            return self
        base = replace(self.base, strain=soften(self.base.strain))
        return replace(self, psd_strain_arclength=psd, base=base)

    def rest_state(self, grid: Grid) -> State:
        """The robot at rest on the grid, from which an estimate starts."""
        rest, still = self.rest, np.zeros((*grid.shape, 6))
        pose = np.broadcast_to(rest.poses(self.base_pose, grid.arclength), (*grid.shape, 4, 4))
        strain = np.broadcast_to(rest.at(grid.arclength), still.shape)
        return State(pose.copy(), strain.copy(), still, still.copy())

    def bent(self, grid: Grid, state: State, step: Array) -> State:
        """The state moved by `step` (K, N, 24) interval by interval from the base outwards.

        The errors of intervals move as the step says to first order, so poses and strains stay
        together however long it is.
        """
        moved = [state.take(np.s_[:, 0]).retract(step[:, 0])]
        for n, h in enumerate(np.diff(grid.arclength)):
            ends = state.take(np.s_[:, n]), state.take(np.s_[:, n + 1])
            lengths = np.full(len(step), h)
            error, j0, j1 = interval_error(*ends, lengths)
            change = (j0 @ step[:, n, :, None] + j1 @ step[:, n + 1, :, None])[..., 0]
            moved.append(interval_end(moved[-1], error + change, lengths))
        fields = zip(*(vars(node).values() for node in moved), strict=True)
        return State(*(np.stack(field, axis=1) for field in fields))

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors that begin at the time nodes `times`, linearised at `state`.

        Every interval, and the base, at the first time and from each of `times` to the next.
        """
        k_count, n_count = grid.shape
        self._require_digits(grid)
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        touched = slice(times.start, min(times.stop + 1, k_count))
        here, steps = node[touched], np.diff(grid.time[touched])
        local = state.take(touched)
        first = times.start == 0 and grid.before is None
        yield from self._chain(first, steps, here[:, :1, None], *self._base(local))
        if n_count == 1:
            return
        ends = local.take(np.s_[:, :-1]), local.take(np.s_[:, 1:])
        step = np.broadcast_to(np.diff(grid.arclength), (len(here), n_count - 1))
        error, *jacobians = interval_error(*ends, step)
        error[..., :12] -= self.rest.interval_errors(grid.arclength)
        cov = self._interval_covariances(grid, noise_state.take(touched))[1]
        yield from self._chain(
            first,
            steps,
            np.stack([here[:, :-1], here[:, 1:]], axis=2),
            error,
            np.stack(jacobians, axis=3),
            cov,
        )

    def _require_digits(self, grid: Grid) -> None:
        """Raise OutsideGridError where time nodes are so dense that information loses digits."""
        steps = np.diff(grid.time)
        if steps.size and np.median(steps) * _DENSEST < self.time_scale:
            raise OutsideGridError(
                f"Time nodes {np.median(steps):.3g} s apart are too dense for a time scale of "
                f"{self.time_scale:g} s: they add nothing and cost all digits; leave "
                f"{self.time_scale / _DENSEST:.3g} s at least between them."
            )

    def _base(self, state: State) -> tuple[Array, Array, Array]:
        """Error [r; ṙ] (K, 1, 24) of the base, its Jacobian (K, 1, 24, 1, 24) and variance."""
        at = state.take(np.s_[:, :1])
        error, jacobian = place_error(self.base_pose, self.rest.at(np.zeros(1)), at)
        variance = np.concatenate([self.base.pose, self.base.strain])
        cov = np.broadcast_to(np.diag(variance), (*error.shape[:2], 12, 12))
        return error, jacobian[..., None, :], cov

    def _chain(
        self,
        first: bool,
        steps: Array,
        nodes: Index,
        error: Array,
        jacobian: Array,
        cov: Array,
    ) -> Iterator[Factors]:
        """Factors of processes with errors (K, I, 24), Q (K, I, 12, 12) and nodes (K, I, c)."""
        count = nodes.shape[2]

        if first:
            root = np.diag(np.diagonal(matern.stationary(self.time_scale)) ** -0.5)
            terms = Residuals(error[0], kron_pair(root, pair_sqrt_information(cov[0])))
            yield Factors(nodes[0], _ALL, jacobian[0], terms)
        if not len(steps):
            return
        fade = matern.transition(self.time_scale, steps)[:, None]
        root = np.linalg.inv(np.linalg.cholesky(matern.process_covariance(self.time_scale, steps)))
        before = error[:-1].reshape(*error[:-1].shape[:2], 2, 12)
        slopes = jacobian[:-1].reshape(*before.shape, count * RATED)
        innovation = error[1:] - (fade @ before).reshape(error[1:].shape)
        fading = fade @ slopes.reshape(*before.shape[:3], -1)
        both = np.empty((*innovation.shape, 2 * count, RATED))
        both[..., :count, :] = -fading.reshape(both[..., :count, :].shape)
        both[..., count:, :] = jacobian[1:]
        joined = np.concatenate([nodes[:-1], nodes[1:]], axis=2)
        info = kron_pair(root[:, None], pair_sqrt_information(0.5 * (cov[:-1] + cov[1:])))
        terms = Residuals(innovation.reshape(-1, RATED), info.reshape(-1, RATED, RATED))
        shape = -1, RATED, 2 * count, RATED
        yield Factors(joined.reshape(-1, 2 * count), _ALL, both.reshape(shape), terms)

    def _interval_covariances(self, grid: Grid, noise_state: State) -> tuple[Array, Array]:
        """Strains (K, N−1, 6) that intervals are linearised about, and their Q (K, N−1, 12, 12)."""
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
        """Factors of shapes that hold still, linearised at nodes (S, N) of pose and strain."""
        base = self.base_pose, self.base
        yield from static_factors(grid, state, self.rest, self._intervals(grid), base)

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """State at points between the nodes, conditional on the nodes. Source: (10) to (12).

        Inside a cell: along arclength at both times, then along time. What is left uncertain is
        that of the whole process, Σ_s ⊗ P∞ + (K_s − Σ_s) ⊗ Σ_t with K_s the prior covariance of the
        cross-section, Σ_s and Σ_t what the bridges along arclength and along time leave.
        """
        s, t = points.along, points.through
        k = t.lower if points.inside_time else t.nearest
        n = s.lower if points.inside_arclength else s.nearest
        crossing = self._crossing(grid, noise_state, k, s) if points.inside_arclength else None
        rest = self._rest_within(grid, s) if points.inside_arclength else None

        if not points.inside_time:
            at, nodes, jacobian = at_time_nodes(state, k, n, s, crossing, rest)
            at, jacobian, time_left = replace(at, strain_rate=None), jacobian[:, :DOF], None
        else:
            early, late = (at_time_nodes(state, k + i, n, s, crossing, rest) for i in (0, 1))
            at, j0, j1, time_left = self._along_time(early[0], late[0], t, points.arclength)
            jacobian = np.concatenate([chained(j0, early[2]), chained(j1, late[2])], axis=2)
            nodes = np.concatenate([early[1], late[1]], axis=1)
        if crossing is None and time_left is None:  # on nodes
            return Interpolation(at, nodes, jacobian, np.zeros((k.size, DOF, DOF)))
        left = np.zeros((k.size, RATED, RATED))
        if crossing is not None:
            left += kron_pair(matern.stationary(self.time_scale), crossing[1])
        if time_left is not None:
            section = self._section(grid, noise_state, k, n, s, points.inside_arclength)
            known = section if crossing is None else section - crossing[1]
            left += kron_pair(time_left, known)
        return Interpolation(at, nodes, jacobian, _in_body(at, left[:, :DOF, :DOF]))

    def _crossing(self, grid: Grid, noise_state: State, k: Index, s: Cells) -> tuple[Array, Array]:
        """Gain and covariance (M, 12, 12) inside the intervals `s` at time nodes k."""
        psd, jump = (values[s.lower] for values in self._intervals(grid))
        ends = noise_state.strain[k, s.lower], noise_state.strain[k, s.lower + 1]
        rate = interval_strain(*ends, s.step, (psd, jump))
        return bridge(rate, s.step, s.offset, psd, jump)

    def _rest_within(self, grid: Grid, s: Cells) -> tuple[Array, Array]:
        """Errors (M, 12) at rest of the intervals `s`, and of their parts up to the points."""
        whole = self.rest.interval_errors(grid.arclength)[np.minimum(s.lower, grid.shape[1] - 2)]
        return whole, self.rest.error(grid.arclength[s.lower], s.offset)

    def _along_time(
        self, early: State, late: State, t: Cells, arclength: Array
    ) -> tuple[State, Array, Array, Array]:
        """State (M,) within time steps, its Jacobians (M, 18, 24) at both ends, and Σ_t."""
        fading, rising, left = matern.bridge(self.time_scale, t.step, t.offset)
        gain = np.einsum("mij,ab->miajb", rising, np.eye(6)).reshape(-1, 12, 12)
        pose, velocity, j0, j1 = pair_between(TIME, early, late, t.step, t.offset, gain)
        strain = rest = self.rest.at(arclength)
        for end, weights, j in ((early, fading, j0), (late, rising, j1)):
            strain = strain + weights[:, 0, :1] * (end.strain - rest)
            strain = strain + weights[:, 0, 1:] * strain_rate_of(end)
            j[:, STRAIN, STRAIN] = weights[:, 0, 0, None, None] * np.eye(6)
            j[:, STRAIN, STRAIN_RATE] = weights[:, 0, 1, None, None] * np.eye(6)
        return State(pose, strain, velocity), j0, j1, left

    def _section(
        self, grid: Grid, noise_state: State, k: Index, n: Index, s: Cells, inside: bool
    ) -> Array:
        """Prior covariance K_s (M, 12, 12) of pose and strain, along the shapes at time nodes k."""
        times, which = np.unique(k, return_inverse=True)
        there = noise_state.take(times)
        cov = np.empty((*there.strain.shape[:2], 12, 12))
        cov[:, 0] = np.diag(np.concatenate([self.base.pose, self.base.strain]))
        strain, noise = self._interval_covariances(grid, there)
        onward = transition(strain, np.broadcast_to(np.diff(grid.arclength), strain.shape[:2]))
        for i in range(grid.arclength.size - 1):
            cov[:, i + 1] = onward[:, i] @ cov[:, i] @ _transposed(onward[:, i]) + noise[:, i]
        if not inside:
            return cov[which, n]
        psd, strain = self._intervals(grid)[0][n], strain[which, n]
        onward = transition(strain, s.offset)
        noise = process_covariances(strain, s.offset, psd, psd, rigid=False)[0]
        return onward @ cov[which, n] @ _transposed(onward) + noise


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)


def _in_body(at: State, left: Array) -> Array:
    """Covariance (M, 18, 18) of the body's velocity from that of the pose's rate, in place."""
    curl = se3.ad(at.velocity)
    left[..., VELOCITY, :] += curl @ left[..., POSE, :]
    left[..., VELOCITY] += left[..., POSE] @ _transposed(curl)
    return left
