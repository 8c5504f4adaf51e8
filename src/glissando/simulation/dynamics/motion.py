"""Simulated motion with inertia: poses, velocities, accelerations and loads at any point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from glissando.geometry.se3 import Array
from glissando.simulation.dynamics.scenario import ScenarioLoads
from glissando.simulation.mesh import Mesh
from glissando.simulation.rod import Rod
from glissando.simulation.shape import Section, require_on_rod

_CHUNK = 500  # queries at a time, to bound memory


class Moment(NamedTuple):
    """End of a step: state (3, G, 6), energies (3,) and accumulated works (3,), J.

    `base` is force and moment on the base (2, 3), `tension` the tendons' tensions (T,), and
    `begins` whether an interval after an event begins here.
    """

    time: float
    state: Array
    energy: Array
    work: Array
    base: Array
    tension: Array
    begins: bool


@dataclass(frozen=True)
class MovingSection(Section):
    """Cross-sections of a moving rod; leading dimensions are those of the query.

    Attributes:
        velocity: Velocity and angular velocity (…, 6), body frame.
        acceleration: Inertial linear and angular acceleration of the section (…, 6), expressed in
            body axes, m/s² and rad/s².
        specific_force: Acceleration minus gravity (…, 3), as measured by an accelerometer, body
            axes, m/s².
    """

    velocity: Array
    acceleration: Array
    specific_force: Array


@dataclass(frozen=True)
class Energies:
    """Energies and accumulated works over time, J: the change of energy equals the sum of works.

    Attributes:
        time: Times (K,), s.
        kinetic, strain, weight: Kinetic, strain and gravitational potential energy (K,).
        supplied: Work of tendons, loads and the base (K,).
        contact: Work of contacts and holds (K,).
        dissipated: Work of the damping of material and air (K,), ≤ 0.
    """

    time: Array
    kinetic: Array
    strain: Array
    weight: Array
    supplied: Array
    contact: Array
    dissipated: Array

    @property
    def total(self) -> Array:
        """Sum of the energies (K,)."""
        return self.kinetic + self.strain + self.weight

    @property
    def imbalance(self) -> Array:
        """Change of energy since the start minus the works (K,): the error of integration."""
        works = self.supplied + self.contact + self.dissipated
        return self.total - self.total[0] - works


@dataclass(frozen=True)
class DynamicMotion:
    """Motion of a rod with inertia: strains at the ends of steps, with quintic interpolation.

    Attributes:
        acting: Scenario and equations of the rod.
        time: Ends of the steps (K,), s; the time of an event occurs twice.
        state: Strain and its first and second time derivative (3, K, G, 6).
        energies: Energies and works at these times.
        base_wrench: Force and moment of the rod on its base (K, 6), world axes.
        tensions: Tension of each tendon at the base (K, T), N.
        begins: Whether an interval after an event begins at each time (K,).
    """

    acting: ScenarioLoads
    time: Array
    state: Array
    energies: Energies
    base_wrench: Array
    tensions: Array
    begins: Array

    @staticmethod
    def of(acting: ScenarioLoads, moments: list[Moment]) -> DynamicMotion:
        """Motion with these ends of steps, in the order of time."""
        time = np.array([m.time for m in moments])
        energy, work = np.array([m.energy for m in moments]), np.array([m.work for m in moments])
        state = np.stack([m.state for m in moments], axis=1)
        begins = np.array([m.begins for m in moments])
        first = np.flatnonzero(begins)
        state[2, first] = state[2, np.minimum(first + 1, len(time) - 1)]
        base = np.array([m.base.ravel() for m in moments])
        tension = np.array([m.tension for m in moments])
        return DynamicMotion(
            acting, time, state, Energies(time, *energy.T, *work.T), base, tension, begins
        )

    @property
    def rod(self) -> Rod:
        """The rod."""
        return self.acting.equations.rod

    @property
    def mesh(self) -> Mesh:
        """Mesh of the strains."""
        return self.acting.equations.mesh

    def at(self, arclength: ArrayLike, time: ArrayLike) -> MovingSection:
        """Cross-sections at arclengths (m) and times (s), which are broadcast together.

        Times before the first and after the last are clipped. Raises SimulationError for arclengths
        off the rod.
        """
        s, t = np.broadcast_arrays(
            np.asarray(arclength, dtype=float), np.asarray(time, dtype=float)
        )
        shape, s, t = s.shape, s.ravel(), np.clip(t.ravel(), self.time[0], self.time[-1])
        require_on_rod(self.rod, s)
        instants, which = np.unique(t, return_inverse=True)
        parts = [np.empty((s.size, *tail)) for tail in ((4, 4), (6,), (6,), (6,), (6,), (3,))]
        order = np.argsort(which, kind="stable")
        for rows in np.array_split(order, max(1, s.size // _CHUNK)):
            first, last = which[rows[0]], which[rows[-1]]
            times = instants[first : last + 1]
            for part, values in zip(
                parts, self._rows(s[rows], times, which[rows] - first), strict=True
            ):
                part[rows] = values
        return MovingSection(*(part.reshape(*shape, *part.shape[1:]) for part in parts))

    def _rows(self, s: Array, times: Array, which: np.ndarray) -> tuple[Array, ...]:
        """Fields of `MovingSection` at arclengths (M,), each at the time of index `which` (M,)."""
        equations, mesh, points = self.acting.equations, self.mesh, len(self.acting.equations.rest)
        states, middles = self.states_at(times)
        rates = np.empty((len(times), 4, points, 3))
        edges = np.tile(np.eye(4), (len(times), mesh.edges.size, 1, 1))
        gravity = np.asarray(self.acting.scenario.gravity, dtype=float)
        for k, time in enumerate(times):
            instant = self.acting.at(float(time), float(middles[k]))
            at = equations.at(states[k], instant)
            rates[k], edges[k, 0] = at.rates[:, :points], instant.base
            edges[k, 1:, :3, :3], edges[k, 1:, :3, 3] = at.turn[points:], at.place[points:]
        fields = np.concatenate(
            [*np.moveaxis(states[:, :2], 1, 0), *np.moveaxis(rates, 1, 0)], axis=-1
        )
        values = mesh.interpolate(fields[which], s)
        strain, rate, motion = values[:, :6], values[:, 6:12], values[:, 12:].reshape(-1, 4, 3)
        pose = mesh.pose_at(states[which, 0], edges[which], s)
        spring = strain - self.rod.rest(s) + self.rod.retardation * rate
        rotation_inverse = np.swapaxes(pose[:, :3, :3], -1, -2)[:, None]
        body = (rotation_inverse @ motion[..., None])[..., 0]
        specific_force = body[:, 2] - rotation_inverse[:, 0] @ gravity
        velocity, acceleration = body[:, :2].reshape(-1, 6), body[:, 2:].reshape(-1, 6)
        return pose, strain, self.rod.stiffness * spring, velocity, acceleration, specific_force

    def strains(self, time: Array) -> Array:
        """Strains (M, G, 6) at the mesh's points at times (M,), s."""
        inside = np.clip(time, self.time[0], self.time[-1])
        return self.states_at(inside)[0][:, 0]

    def states_at(self, time: Array) -> tuple[Array, Array]:
        """Strains with two time derivatives (M, 3, G, 6) at times (M,), and middles of steps, s."""
        k = np.clip(np.searchsorted(self.time, time, "right") - 1, 0, self.time.size - 2)
        k = np.where(self.begins[k + 1], k - 1, k)
        low, high = self.time[k], self.time[k + 1]
        ends = np.moveaxis(self.state[:, k], 1, 0), np.moveaxis(self.state[:, k + 1], 1, 0)
        return _quintic(*ends, high - low, (time - low) / (high - low)), 0.5 * (low + high)


def _quintic(first: Array, last: Array, span: Array, x: Array) -> Array:
    """Values and two derivatives (M, 3, …) of the quintic Hermite interpolation at fractions x."""
    scale = np.stack([np.ones_like(span), span, span**2], axis=1)
    known = np.concatenate([first * scale[..., None, None], last * scale[..., None, None]], axis=1)
    k = np.arange(6)
    powers = np.stack(
        [
            x[:, None] ** k,
            k * x[:, None] ** np.maximum(k - 1, 0),
            k * (k - 1) * x[:, None] ** np.maximum(k - 2, 0),
        ],
        axis=1,
    )
    weights = powers @ _TO_QUINTIC / scale[..., None]
    return np.einsum("mij,mj...->mi...", weights, known, optimize=True)


_TO_QUINTIC = np.linalg.inv(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 2, 0, 0, 0],
        [1, 1, 1, 1, 1, 1],
        [0, 1, 2, 3, 4, 5],
        [0, 0, 2, 6, 12, 20],
    ]
)
