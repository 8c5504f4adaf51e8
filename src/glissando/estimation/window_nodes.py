"""The time nodes of a sliding window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.state import State


@dataclass(frozen=True)
class Nodes:
    """Time nodes of a window: linearisation points, and the step to the estimate.

    Attributes:
        time: Times (K,), s.
        state: Linearisation points (K, N).
        parameters: Linearisation points of the sensor parameters (K, E).
        step: Step (K, D) that leads to the estimate.
        own: Derivative (K, N, dof) of the state by a delay, per second; see `delays`.
    """

    time: Array
    state: State
    parameters: Array
    step: Array
    own: Array

    def __len__(self) -> int:
        return int(self.time.size)

    def take(self, rows: slice) -> Nodes:
        """Some of the nodes."""
        parts = self.parameters[rows], self.step[rows], self.own[rows]
        return Nodes(self.time[rows], self.state.take(rows), *parts)

    def followed_by(self, time: float, state: State, parameters: Array) -> Nodes:
        """These nodes, followed by one at a time with state (N,) and sensor parameters (E,)."""
        fields = zip(self.state.fields(), state.fields(), strict=True)
        return Nodes(
            np.append(self.time, time),
            State(*[np.concatenate([each, new[None]]) for each, new in fields]),
            np.concatenate([self.parameters, parameters[None]]),
            np.concatenate([self.step, np.zeros((1, self.step.shape[1]))]),
            np.concatenate([self.own, np.zeros((1, *self.own.shape[1:]))]),
        )

    def stepped(self, step: Array) -> Nodes:
        """The nodes with another step (K, D)."""
        return Nodes(self.time, self.state, self.parameters, step, self.own)

    @cached_property
    def estimate(self) -> tuple[State, Array]:
        """The states (K, N) and sensor parameters (K, E) to which the step leads."""
        of_nodes = self.state.numbers
        step = self.step[:, :of_nodes].reshape(*self.state.pose.shape[:2], -1)
        return self.state.retract(step), self.parameters + self.step[:, of_nodes:]

    @cached_property
    def newest(self) -> tuple[State, Array]:
        """State (N,) and sensor parameters (E,) of the newest node's estimate."""
        last, of_nodes = self.state.take(-1), self.state.numbers
        step = self.step[-1, :of_nodes].reshape(len(last.pose), -1)
        return last.retract(step), self.parameters[-1] + self.step[-1, of_nodes:]

    def at_estimate(self, first: int) -> Nodes:
        """The nodes, from `first` on with their estimates as linearisation points."""
        if not self.step[first:].any():
            return self
        step, (state, parameters) = self.step.copy(), self.estimate
        step[first:] = 0.0
        fields = zip(self.state.fields(), state.fields(), strict=True)
        return Nodes(
            self.time,
            State(*[np.concatenate([fixed[:first], moved[first:]]) for fixed, moved in fields]),
            np.concatenate([self.parameters[:first], parameters[first:]]),
            step,
            self.own,
        )
