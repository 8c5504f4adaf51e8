"""The rod of a mechanical prior under its loads, divided into intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando.errors import OutsideGridError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index, node_at
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.flow import Section
from glissando.model.priors.mechanical.intervals import Intervals
from glissando.model.priors.mechanical.tip import tip_error, with_tool_inertia
from glissando.model.priors.rest_shape import RestShape
from glissando.model.state import State


@dataclass(frozen=True)
class LoadedRod:
    """A rod under unknown loads.

    Attributes:
        mechanics: Stiffness, weight and the tool at the tip.
        rest: Shape without loads.
        psd: Densities (12,) along arclength of strain errors and of loads.
        points: Arclengths (P,) at which a wrench may act, m.
        var_points: Variances (P, 6) of these wrenches, N² and N² m².
    """

    mechanics: Mechanics
    rest: RestShape
    psd: Array
    points: Array
    var_points: Array

    @property
    def joints(self) -> Array:
        """Arclengths (J,) at which segments meet or a wrench may act, m."""
        return np.union1d(self.mechanics.joints, self.points)

    def wrench(self, strain: Array, arclength: Array) -> tuple[Array, Array]:
        """Internal wrench (…, 6) at a strain (…, 6), and the stiffness (…, 6) there.

        Args:
            strain: Strain, body frame.
            arclength: Arclengths (…), m; at a joint or a point load, just beyond it.
        """
        s = np.asarray(arclength, dtype=float)
        stiffness = self.mechanics.stiffness[self.mechanics.segment(s)]
        rest = self.rest.at(s.ravel()).reshape(*s.shape, 6)
        return stiffness * (strain - rest), stiffness

    @cached_property
    def _last(self) -> dict[bytes, Intervals]:
        """Cache of the last intervals by their nodes, since an update uses them repeatedly."""
        return {}

    def intervals(self, arclength: Array) -> Intervals:
        """Intervals (N−1,) between arclength nodes (N,), cached, so not to be changed.

        Raises:
            OutsideGridError: A segment begins or a wrench acts between nodes.
        """
        key = arclength.tobytes()
        intervals = self._last.get(key)
        if intervals is None:
            intervals = self._cut(arclength)
            self._last.clear()
            self._last[key] = intervals
        return intervals

    def _cut(self, arclength: Array) -> Intervals:
        jump = np.zeros((arclength.size - 1, 6))
        for place in self.joints:
            at = node_at(arclength, place, "A segment begins or a load acts")
            which = np.flatnonzero(self.points == place)
            if at and which.size:
                jump[at - 1] = self.var_points[which[0]]
        begin, end = arclength[:-1], arclength[1:]
        mechanics, rest = self.mechanics, self.rest
        segment = mechanics.segment(0.5 * (begin + end))
        slope = rest.slope[np.searchsorted(rest.joints, 0.5 * (begin + end))]
        mass = mechanics.mass_per_length[segment]
        section = Section(
            mechanics.stiffness[segment],
            rest.at(begin),
            slope,
            mass[:, None] * np.atleast_2d(mechanics.gravity)[0],
            np.broadcast_to(self.psd, (begin.size, 12)),
            np.zeros((begin.size, 3)),
        )
        beyond = mechanics.stiffness[mechanics.segment(end)]
        return Intervals(np.diff(arclength), section, beyond, rest.at(end), jump, mass)

    def tiled(self, grid: Grid, count: int) -> Intervals:
        """Intervals of the grid, repeated for `count` times or shapes (count · (N−1),)."""
        pieces = grid.arclength.size - 1
        return self.pick(
            grid, np.repeat(np.arange(count), pieces), np.tile(np.arange(pieces), count)
        )

    def pick(self, grid: Grid, k: Index, n: Index) -> Intervals:
        """Intervals n (M,) of the grid at time nodes or static shapes k (M,)."""
        intervals, gravity = self.intervals(grid.arclength).take(n), self.mechanics.gravity
        if gravity.ndim == 1:
            return intervals
        if len(gravity) <= k.max(initial=0):
            raise OutsideGridError(
                f"Gravity is given for {len(gravity)} shapes and there are {k.max() + 1} or more; "
                f"give a row for each, or one for all."
            )
        mass = self.mechanics.mass_per_length
        segment = self.mechanics.segment(grid.arclength[n])
        return replace(
            intervals, section=replace(intervals.section, weight=mass[segment, None] * gravity[k])
        )

    def tip_error(self, grid: Grid, at: State, shape: Index | None = None) -> tuple[Array, Array]:
        """Error of the tip's wrench (…, 12) and its Jacobian (…, 12, dof), see `tip_error`.

        `shape` (M,) are the static shapes to which the tips belong; all in order if absent.
        """
        mechanics = self.mechanics
        if shape is not None and mechanics.gravity.ndim == 2:
            mechanics = replace(mechanics, gravity=mechanics.gravity[shape])
        error = tip_error(mechanics, self.rest.at(grid.arclength[-1:])[0], at)
        return error if at.inertia is None else with_tool_inertia(mechanics, at, *error)
