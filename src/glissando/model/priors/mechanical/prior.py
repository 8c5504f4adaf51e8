"""The mechanical prior: a rod of known stiffness and weight under unknown loads.

Loads are white noise along arclength, and a separate wrench at each point where one is expected;
in time they are Matérn processes, as the interval errors of the separable prior are. The base's
pose has a Gaussian prior; its wrench has none, since it follows from the loads. Strain and internal
wrench of a node are equivalent, W = K (ε − ε*). Source: equations (26) and (27).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from glissando.errors import OutsideGridError
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.field_checks import FieldChecks
from glissando.model.grid import Cells, Grid, Index
from glissando.model.interpolation import Interpolation
from glissando.model.mechanics import Mechanics
from glissando.model.noise import sqrt_information
from glissando.model.priors.intervals import RATED
from glissando.model.priors.mechanical.beam_modes import beam_modes
from glissando.model.priors.mechanical.bend import retract_strains
from glissando.model.priors.mechanical.ends import RodEnds
from glissando.model.priors.mechanical.inertia import Inertia, ModalMotion
from glissando.model.priors.mechanical.intervals import (
    bridge,
    interval_between,
    interval_error,
    still_error,
)
from glissando.model.priors.mechanical.modal_acceleration import modal_acceleration
from glissando.model.priors.mechanical.point_load import PointLoad, point_load
from glissando.model.priors.mechanical.rod import LoadedRod
from glissando.model.priors.mechanical.section import LinearizedRods, hanging_rod
from glissando.model.priors.mechanical.table import read_fields
from glissando.model.priors.rest_shape import STRAIGHT, RestShape
from glissando.model.priors.static import STATIC_DOF
from glissando.model.priors.stationary import StationaryPrior, chain_factors
from glissando.model.state import State
from glissando.model.table import Table, pose_table

_REACH = 0.3  # m, over which a load acts, for orders of magnitude
_SOFT = 0.022  # m, ratio of shear to curvature
_NO_FORCE = 1e-6
_STATIC = slice(0, STATIC_DOF)
_ENDS = (slice(None, -1), slice(1, None))  # arclength nodes at which intervals begin and end


@dataclass(frozen=True)
class MechanicalPrior(StationaryPrior):
    """Gaussian process on the loads of a rod over arclength × time.

    Attributes:
        mechanics: Stiffness, weight and the tool at the tip.
        psd_load: Density (6,) of the load's white noise along arclength, N²/m and N² m: a piece of
            length h carries a wrench of variance h · psd_load.
        psd_strain_error: Density (6,) of the deviation of strain from that of the wrench (set,
            friction), white along arclength: strain² · m.
        var_tip: Variance (6,) of the unknown wrench at the tip, N² and N² m².
        time_scale: Correlation time of the loads, s.
        var_base: Variance (6,) of the base's pose about `base_pose`.
        base_pose: Mean pose (4, 4) of the base.
        rest_strain: Strain without loads, (6,), or (S, 6) where the segments begin.
        rest_slope: Change of the rest strain per metre, (6,) or (S, 6).
        points: Arclengths (P,) at which a wrench may act, m.
        var_points: Variances (P, 6) of these wrenches, N² and N² m².
        inertia: Parameters of the rod's inertia; None for motion so slow that it is negligible.
    """

    mechanics: Mechanics
    psd_load: Array
    psd_strain_error: Array
    var_tip: Array
    time_scale: float
    var_base: Array
    base_pose: Array = field(default_factory=lambda: np.eye(4))
    rest_strain: Array = field(default_factory=STRAIGHT.copy)
    rest_slope: Array = field(default_factory=lambda: np.zeros(6))
    points: Array = field(default_factory=lambda: np.zeros(0))
    var_points: Array = field(default_factory=lambda: np.zeros((0, 6)))
    inertia: Inertia | None = None
    kind: ClassVar[str] = "mechanical"
    kernels: ClassVar = (
        "information", "intervals", "rod_flow", "rod_intervals", "rod_tip", "stationary",
    )  # fmt: skip

    def __post_init__(self) -> None:
        stated = FieldChecks(self)
        for name in ("psd_load", "psd_strain_error", "var_tip", "var_base"):
            stated.numbers(name, (6,), above=0.0)
        stated.number("time_scale", above=0.0)
        stated.pose("base_pose")
        if not isinstance(self.mechanics, Mechanics):
            raise stated.fail("mechanics", f"is {self.mechanics!r}; give a Mechanics.")
        stated.rest(self.mechanics.joints.size + 1)
        stated.numbers("rest_slope", (6,), (self.mechanics.joints.size + 1, 6))
        stated.numbers("var_points", (stated.places("points").size, 6), least=0.0)

    @classmethod
    def from_table(cls, prior: Table, robot: Table) -> MechanicalPrior:
        """Prior from the table [prior] of a robot file, and from the file with [mechanics]."""
        return cls(**read_fields(prior, robot))

    def to_table(self) -> dict[str, Any]:
        """Tables of a robot file for this prior, in the form that `from_table` reads."""
        prior: dict[str, Any] = {"kind": self.kind, "time_scale": float(self.time_scale)}
        for name in ("psd_load", "psd_strain_error", "var_tip"):
            prior[name] = getattr(self, name).tolist()
        if self.points.size:
            prior |= {"points": self.points.tolist(), "var_points": self.var_points.tolist()}
        if self.inertia is not None:
            prior["inertia"] = self.inertia.to_table()
        base = pose_table(self.base_pose) | {"var_pose": self.var_base.tolist()}
        rest = {key: getattr(self, key).tolist() for key in ("rest_strain", "rest_slope")}
        return {**rest, "mechanics": self.mechanics.to_table(), "prior": prior, "base": base}

    @property
    def joints(self) -> Array:
        """Arclengths (J,) of ends of segments and point loads, m, which must be grid nodes."""
        return self.rod.joints

    @cached_property
    def rod(self) -> LoadedRod:
        """The rod under loads, which is divided into intervals."""
        psd = np.concatenate([self.psd_strain_error, self.psd_load])
        return LoadedRod(self.mechanics, self.rest, psd, self.points, self.var_points)

    @cached_property
    def ends(self) -> RodEnds:
        """The rod's base and tip."""
        return RodEnds(self.rod, self.base_pose, self.var_base, self.var_tip)

    @property
    def rest(self) -> RestShape:
        """The shape without loads."""
        return RestShape.of_segments(self.rest_strain, self.rest_slope, self.mechanics.joints)

    def with_soft_shear(self) -> MechanicalPrior:
        """Prior for a first estimate: large moments, hardly any forces, and soft shear.

        Its shapes follow the readings as those of a strain prior do, and the moments follow from
        the shapes. From there only the forces remain to be found.
        """
        if self.inertia is not None:
            return self._loaded()
        wrench = self.var_tip + self.var_points.sum(axis=0) + _REACH * self.psd_load
        moment = np.repeat(wrench[3:].max() + _REACH**2 * wrench[:3].max(), 3)
        curvature = moment[0] / (_REACH * self.mechanics.stiffness[:, 3:5].min() ** 2)
        shear = np.maximum(self.psd_strain_error[:3], (_SOFT * _REACH) ** 2 / 3.0 * curvature)
        none = _NO_FORCE * wrench[:3]
        return replace(
            self,
            psd_load=np.concatenate([none / _REACH, moment / _REACH]),
            psd_strain_error=np.concatenate([shear, self.psd_strain_error[3:]]),
            var_tip=np.concatenate([none, moment]),
            var_points=np.zeros_like(self.var_points),
        )

    def _loaded(self) -> MechanicalPrior:
        """Prior for a first estimate of a moving rod: loads as large as inertial forces may be."""
        assert self.inertia is not None
        force = self.inertia.std_release**2
        wide = np.repeat([force, force * _REACH**2 * 1e-4], 3)
        return replace(
            self,
            psd_load=np.maximum(self.psd_load, wide / _REACH),
            var_tip=np.maximum(self.var_tip, 0.1 * wide),
        )

    def of_shape(self, number: int) -> MechanicalPrior:
        """Prior of one of several static shapes, with the gravity of that shape."""
        gravity = np.atleast_2d(self.mechanics.gravity)
        own = gravity[number if len(gravity) > 1 else 0]
        return replace(self, mechanics=replace(self.mechanics, gravity=own))

    def rest_state(self, grid: Grid) -> State:
        """State of the robot under its own weight without loads, from which estimates start."""
        still, count = np.zeros((*grid.shape, 6)), len(np.atleast_2d(self.mechanics.gravity))
        if count > 1 and count != grid.time.size:
            raise OutsideGridError(
                f"Gravity is given for {count} shapes and there are {grid.time.size}; give a row "
                f"for each, or one for all."
            )
        base = np.broadcast_to(self.base_pose, (count, 4, 4))
        pose, strain = hanging_rod(self.mechanics, self.rod.tiled(grid, count), base)
        pose = np.broadcast_to(pose, (*grid.shape, 4, 4)).copy()
        more = [still.copy()] if self.inertia is not None else []
        return State(pose, np.broadcast_to(strain, still.shape).copy(), still, still.copy(), *more)

    def retract_strains(self, grid: Grid, state: State, step: Array) -> State:
        """State after a `step` (K, N, dof), built interval by interval from the base outwards.

        With inertia it is `retract`, since accelerations are tied to positions in the world frame.
        """
        if self.inertia is not None:
            return state.retract(step)
        times = np.arange(len(step))
        pieces = [
            self.rod.pick(grid, times, np.full(times.size, n))
            for n in range(grid.arclength.size - 1)
        ]
        return retract_strains(pieces, partial(self.rod.tip_error, grid), state, step)

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors that begin at the time nodes `times`, linearised at `state`.

        They are of the base, the tip and every interval, at the first time and from each of
        `times` to the next.
        """
        k_count, n_count = grid.shape
        self.require_digits(grid)
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        touched = slice(times.start, min(times.stop + 1, k_count))
        nodes, local = node[touched], state.take(touched)
        first = times.start == 0 and grid.before is None
        chain = self.time_scale, first, np.diff(grid.time[touched])
        yield from self.ends.factors(chain, grid, local, nodes)
        if n_count == 1:
            return
        if self.inertia is not None:
            motion = self._motion(grid.arclength)
            own = min(times.stop, k_count) - times.start
            yield from motion.factors(first, own, grid.time[touched], nodes, local)
        shape, every = (len(nodes), n_count - 1), self.rod.tiled(grid, len(nodes))
        start, end = (local.take(np.s_[:, part]).flatten() for part in _ENDS)
        error, slopes = interval_error(start, end, every)
        yield from chain_factors(
            *chain,
            np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2),
            error.reshape(*shape, RATED),
            slopes.reshape(*shape, RATED, 2, state.dof),
            self._rods.at(grid, noise_state).noise[touched],
            paired=False,
        )

    def _motion(self, arclength: Array) -> ModalMotion:
        """Modal motion of the rod on arclength nodes (N,)."""
        inertia, mechanics = self.inertia, self.mechanics
        assert inertia is not None
        if arclength.size <= inertia.modes:
            raise OutsideGridError(
                f"A rod of {inertia.modes} modes needs {inertia.modes + 1} arclength nodes or more "
                f"and has {arclength.size}; add nodes, or ask for fewer modes in [prior.inertia]."
            )
        loads = float(self.psd_load[:3].max()), float(self.var_tip[:3].max())
        points = self.points, self.var_points[:, :3].max(axis=1, initial=0.0)
        modes = beam_modes(mechanics, arclength, inertia.modes, loads, points)
        damping = inertia.damping(modes, float(mechanics.mass_per_length.mean()))
        return ModalMotion(modes, damping, inertia.std_release**2, self.time_scale)

    def static_factors(self, grid: Grid, state: State) -> Iterator[Factors]:
        """Factors of static shapes, linearised at pose and strain of nodes (S, N)."""
        state = replace(state, inertia=None)
        count, n_count = grid.shape
        node = np.arange(count * n_count).reshape(count, n_count)
        if n_count > 1:
            every = self.rod.tiled(grid, count)
            start, end = (state.take(np.s_[:, part]).flatten() for part in _ENDS)
            error, slopes = still_error(start, end, every)
            whitener = sqrt_information(every.flow(start, noisy=True).noise)
            nodes = np.stack([node[:, part].ravel() for part in _ENDS], axis=1)
            terms = Residuals(error, whitener)
            yield Factors(nodes, _STATIC, slopes, terms)
        yield from self.ends.static_factors(grid, state, node)

    def acceleration(
        self, grid: Grid, state: State, at: Interpolation, arclength: Array, time: Array
    ) -> Interpolation | None:
        """States with acceleration at points, or None without inertia. Source: equation (33)."""
        if self.inertia is None:
            return None
        motion = self._motion(grid.arclength)
        return modal_acceleration(motion, grid, state, at, arclength, time)

    def arclength_bridge(
        self, grid: Grid, noise_state: State, k: Index, s: Cells
    ) -> tuple[Array, Array]:
        """Gain and covariance (M, 12, 12) inside the intervals `s` at time nodes k."""
        start = noise_state.take((k, s.lower))
        return bridge(start, self.rod.pick(grid, k, s.lower), s.offset)

    def between(
        self, grid: Grid, start: State, end: State, k: Index, s: Cells, gain: Array
    ) -> tuple[State, Array]:
        """State (M,) inside intervals `s` at times k, and Jacobian (M, 24, 2, dof) by both ends."""
        return interval_between(start, end, self.rod.pick(grid, k, s.lower), s.offset, gain)

    def sections(
        self, grid: Grid, noise_state: State, k: Index, n: Index, s: Cells, inside: bool
    ) -> list[tuple[float, Array]]:
        """Prior covariances (M, 12, 12) of pose and strain at time nodes k, on n or inside `s`."""
        cov = self._rods.covariances(grid, noise_state, k, n, s.offset if inside else None)
        return [(self.time_scale, cov)]

    @cached_property
    def _rods(self) -> LinearizedRods:
        return LinearizedRods(self.rod, self.ends)

    def __getstate__(self) -> dict[str, Any]:
        """Fields that are sent to other processes, without the cached linearisation."""
        return {name: value for name, value in vars(self).items() if name != "_rods"}

    def point_load(self, grid: Grid, state: State, k: Index, n: Index) -> PointLoad:
        """The unknown wrench that acts at arclength nodes n (M,) > 0 at time nodes k (M,).

        Source: equation (28).
        """
        start, end = state.take((k, n - 1)), state.take((k, n))
        nodes = (k * grid.arclength.size + n)[:, None] + np.arange(-1, 1)
        last = n == grid.arclength.size - 1
        piece = self.rod.pick(grid, k, n - 1)
        return point_load(start, end, piece, nodes, (last, *self.rod.tip_error(grid, end, k)))
