"""What a sliding window holds: its nodes, and the normal equations of its intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.state import State, concatenate
from glissando.solver.normal_equations import NormalEquationsBuilder


@dataclass(frozen=True)
class Nodes:
    """The time nodes of a window: where they are linearised, and the step from there.

    Attributes:
        time: Times (K,).
        state: Linearisation point (K, N).
        parameters: That of the sensor parameters (K, E).
        step: Step (K, D) that leads to the estimate.
    """

    time: Array
    state: State
    parameters: Array
    step: Array

    def __len__(self) -> int:
        return int(self.time.size)

    def take(self, rows: slice) -> Nodes:
        """Some of the nodes."""
        return Nodes(self.time[rows], self.state.take(rows), self.parameters[rows], self.step[rows])

    def joined(self, other: Nodes) -> Nodes:
        """These nodes, then the others."""
        return Nodes(
            np.append(self.time, other.time),
            concatenate(self.state, other.state),
            np.concatenate([self.parameters, other.parameters]),
            np.concatenate([self.step, other.step]),
        )

    @property
    def estimate(self) -> tuple[State, Array]:
        """The states (K, N) and sensor parameters (K, E) to which the step leads."""
        of_nodes = self.state.numbers
        step = self.step[:, :of_nodes].reshape(*self.state.pose.shape[:2], -1)
        return self.state.retract(step), self.parameters + self.step[:, of_nodes:]

    def at_estimate(self) -> Nodes:
        """The nodes with their estimates as linearisation points."""
        state, parameters = self.estimate
        return Nodes(self.time, state, parameters, np.zeros_like(self.step))


@dataclass(frozen=True)
class Sums:
    """Normal equations of a window by interval: see `NormalEquationsBuilder`."""

    begin: Array
    end: Array
    across: Array
    rhs_begin: Array
    rhs_end: Array

    def resumed(self, first: int, builder: NormalEquationsBuilder) -> Sums:
        """The sums of the intervals before `first`, then those of a builder."""
        return Sums(
            *(
                np.concatenate([getattr(self, name)[:first], getattr(builder, name)])
                for name in ("begin", "end", "across", "rhs_begin", "rhs_end")
            )
        )
