"""Inertia of a rod: factors between acceleration and motion in terms of bending modes.

A node's `inertia` [β, β̇] is acceleration plus damping, β = p̈ + C ṗ, and its rate. In the balance
of the rod β acts as weight does (`Intervals.accelerated`); here it is related to positions and
velocities. Amplitudes y of the modes obey ÿ + c ẏ = β, and D = β + ω² y varies slowly, so y and ẏ
of the next time follow exactly from D and Ḋ at both ends. Source: equation (32).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import leggauss

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Index
from glissando.model.noise import sqrt_information
from glissando.model.priors import matern
from glissando.model.priors.intervals import strain_rate_of
from glissando.model.priors.mechanical.beam_modes import BeamModes
from glissando.model.priors.stationary import chain_factors
from glissando.model.state import INERTIA, POSE, STRAIN, STRAIN_RATE, VELOCITY, State
from glissando.model.table import Table

_POINTS = 24  # for quadrature over a time step
FASTEST = 5.0  # rad a time step; faster oscillations follow loads without delay
QUICKEST = 30.0  # e-folds of decay a time step
PINNED = 0.1  # m/s², std of the acceleration that no mode contains
_ALL = slice(0, INERTIA.stop)
_P, _R = slice(POSE.start, POSE.start + 3), slice(POSE.start + 3, POSE.stop)
_NU, _NU_RATE = (slice(part.start, part.start + 3) for part in (STRAIN, STRAIN_RATE))
_V, _W = slice(VELOCITY.start, VELOCITY.start + 3), slice(VELOCITY.start + 3, VELOCITY.stop)


@dataclass(frozen=True)
class Inertia:
    """Parameters of a rod's inertia.

    Attributes:
        modes: Number of bending modes with inertia; faster ones follow loads without delay.
        retardation: Kelvin–Voigt retardation time of the material, s.
        air_damping: Damping of the air, N s/m².
        std_release: Std of a force released at the tip, N, which bounds accelerations.
    """

    modes: int
    retardation: float
    air_damping: float
    std_release: float

    @classmethod
    def from_table(cls, table: Table) -> Inertia:
        """Inertia from the table [prior.inertia] of a robot file."""
        modes = table.number("modes", 4)
        retardation = table.number("retardation", 0.0, positive=False)
        if retardation > 1.0:
            raise table.fail("retardation", f"is {retardation:g} s; give seconds, 4e-3 for 4 ms.")
        air = table.number("air_damping", 0.0, positive=False)
        inertia = cls(round(modes), retardation, air, table.number("std_release"))
        if inertia.modes != modes or not 1 <= inertia.modes <= 8:
            raise table.fail("modes", f"is {modes:g}; give a whole number from 1 to 8.")
        table.close()
        return inertia

    def to_table(self) -> dict[str, Any]:
        """Table [prior.inertia], in the form that `from_table` reads."""
        return dict(vars(self))

    def damping(self, modes: BeamModes, mass_per_length: float) -> Array:
        """Damping c (m,) of the modes, 1/s."""
        return self.retardation * modes.rate**2 + self.air_damping / mass_per_length


@dataclass(frozen=True)
class ModalMotion:
    """Damped bending modes, driven by loads with the correlation time `time_scale`, s."""

    modes: BeamModes
    damping: Array
    var_release: float
    time_scale: float

    def factors(
        self, first: bool, own: int, time: Array, nodes: Index, state: State
    ) -> Iterator[Factors]:
        """Factors of the times (K,) with nodes (K, N), linearised at a state (K, N).

        Args:
            first: Whether the first time is the first of all.
            own: Number of times at which factors begin; they end at the last time at most.
            time: Times, s.
            nodes: Indices of the nodes.
            state: State to linearise at.
        """
        values, slopes = modal_values(self.modes, state), modal_slopes(self.modes, state)
        yield from self._release_factors(first, np.diff(time), nodes, values[:, 2:], slopes[:, 2:])
        if len(self.modes.remainder):
            yield self._remainder_factors(nodes[:own], state.take(slice(own)))
        if time.size > 1:
            yield self._motion_factors(np.diff(time), nodes, values, slopes)

    def _release_factors(
        self, first: bool, steps: Array, nodes: Index, values: Array, slopes: Array
    ) -> Iterator[Factors]:
        """Factors that bound modal accelerations by those after the release of a force.

        Otherwise the motion alone determines accelerations, and nothing determines their rates at
        the last time.
        """
        rate = self.modes.rate
        for j, fastest in enumerate(np.maximum(rate, rate[min(1, rate.size - 1)])):
            error = values[:, :, j].reshape(len(nodes), 1, 6)
            slope = slopes[:, :, j].reshape(len(nodes), 1, 6, *slopes.shape[-2:])
            variance = self.var_release * self.modes.at_tip[j] ** 2 * np.eye(3)
            cov = np.broadcast_to(variance, (len(nodes), 1, 3, 3))
            chain = float(np.sqrt(3.0) / fastest), first, steps, nodes[:, None]
            yield from chain_factors(*chain, error, slope, cov, paired=False)

    def _remainder_factors(self, nodes: Index, state: State) -> Factors:
        """Factors that keep the part of nodal accelerations outside the modes close to zero."""
        remainder, (count, n_count) = self.modes.remainder, nodes.shape
        rows = 6 * len(remainder)
        error = np.einsum("zn,knc->kzc", remainder, state.fields()[-1]).reshape(count, rows)
        slope = np.zeros((len(remainder), 6, n_count, INERTIA.stop))
        slope[..., INERTIA] = np.einsum("zn,cd->zcnd", remainder, np.eye(6))
        slope = np.broadcast_to(
            slope.reshape(1, rows, *slope.shape[2:]), (count, rows, *slope.shape[2:])
        )
        std = PINNED * np.repeat([1.0, self.modes.rate[-1]], 3)
        whitener = np.broadcast_to(np.diag(np.tile(1.0 / std, len(remainder))), (count, rows, rows))
        return Factors(nodes, _ALL, np.ascontiguousarray(slope), Residuals(error, whitener))

    def _motion_factors(self, steps: Array, nodes: Index, values: Array, slopes: Array) -> Factors:
        """Factors of amplitudes and rates, predicted from the previous ones and D at both ends."""
        count, size = self.modes.rate.size, slopes.shape[-2:]
        steps_of_modes = [self._step(float(h)) for h in steps]
        onward, early, late, info = (np.stack(each) for each in zip(*steps_of_modes, strict=True))
        maps, square = (
            (onward, early, late),
            np.minimum(self.modes.rate, FASTEST / steps[:, None]) ** 2,
        )
        carried, reached = _predicted(maps, square, values)
        before, after = _predicted(maps, square, slopes)
        jacobian = np.concatenate([-before, after], axis=-2)
        shape = len(steps), 6 * count
        return Factors(
            np.concatenate([nodes[:-1], nodes[1:]], axis=1),
            _ALL,
            jacobian.reshape(*shape, 2 * size[0], size[1]),
            Residuals((reached - carried).reshape(shape), info),
        )

    def _step(self, step: float) -> tuple[Array, Array, Array, Array]:
        """Transition, Jacobians by D at both ends (m, 2, 2), square-root information (6 m, 6 m)."""
        modes = self.modes
        onward, early, late, cov = _transition(
            tuple(modes.rate), tuple(self.damping), round(step, 12), self.time_scale
        )
        count = modes.rate.size
        spread = np.einsum("iajb,ij->aibj", cov, modes.load).reshape(2 * count, 2 * count)
        return onward, early, late, sqrt_information(np.kron(spread, np.eye(3)))


def cubic(step: float) -> tuple[Array, Array]:
    """Coefficients (4, 4) of a cubic in t / step by [D, Ḋ] of both ends; its derivatives at 0."""
    coefficients = np.array(
        [[1, 0, 0, 0], [0, step, 0, 0], [-3, -2 * step, 3, -step], [2, step, -2, step]]
    )
    return coefficients, np.diag([1.0, 1.0, 2.0, 6.0]) @ coefficients


def driven_mode(omega: float, damping: float, step: float) -> tuple[Array, Array]:
    """System matrix (2, 2) of a free mode, and (6, 6), times the step, of one under a cubic load.

    Frequency and damping are limited to those that a step resolves.
    """
    omega, damping = min(omega, FASTEST / step), min(damping, QUICKEST / step)
    own = np.array([[0.0, 1.0], [-(omega**2), -damping]])
    chain = np.zeros((6, 6))
    chain[:2, :2], chain[1, 2] = step * own, step
    chain[2, 3] = chain[3, 4] = chain[4, 5] = 1.0
    return own, chain


@lru_cache(maxsize=256)
def _transition(
    rate: tuple[float, ...], damping: tuple[float, ...], step: float, time_scale: float
) -> tuple[Array, Array, Array, Array]:
    """Transition of modes (m, 2, 2), Jacobians by D and Ḋ of both ends, noise (m, 2, m, 2).

    D is a cubic through both ends; its covariance about that is that of loads of unit variance.
    """
    x, w = leggauss(_POINTS)
    time, weight = 0.5 * step * (x + 1.0), 0.5 * step * w
    _, derivatives = cubic(step)
    maps, green = np.zeros((3, len(rate), 2, 2)), np.zeros((len(rate), 2, _POINTS))
    for j, (omega, c) in enumerate(zip(rate, damping, strict=True)):
        own, chain = driven_mode(omega, c, step)
        exponential = scipy.linalg.expm(chain)
        driven = exponential[:2, 2:] @ derivatives
        maps[:, j] = exponential[:2, :2], driven[:, :2], driven[:, 2:]
        green[j] = scipy.linalg.expm((step - time)[:, None, None] * own)[:, :, 1].T
    weighted = green * weight
    cov = np.einsum(
        "iaq,qr,jbr->iajb", weighted, bridge_covariance(step, time_scale, time), weighted
    )
    return maps[0], maps[1], maps[2], cov


def bridge_covariance(step: float, time_scale: float, time: Array) -> Array:
    """Covariance (T, T) at times within a step of a Matérn process whose ends are known."""
    count, out = time.size, np.zeros((time.size, time.size))
    left = matern.bridge(time_scale, np.full(count, step), time)[2]
    for a in range(count):
        out[a, a], onward = left[a, 0, 0], slice(a + 1, None)
        rest = time[onward] - time[a]
        early = matern.bridge(time_scale, np.full(rest.size, step - time[a]), rest)[0]
        out[a, onward] = out[onward, a] = early[:, 0] @ left[a][:, 0]
    return out


def _predicted(maps: tuple[Array, Array, Array], square: Array, each: Array) -> tuple[Array, Array]:
    """Predictions over steps, and values at their ends less the contribution of D there.

    Args:
        maps: Transition and Jacobians by D at both ends of steps, (K−1, m, 2, 2) each.
        square: ω² (K−1, m).
        each: Values or Jacobians (K, 4, m, …) of position, velocity, β and β̇.
    """
    onward, early, late = maps
    own = square.reshape(len(square), 1, -1, *(1,) * (each.ndim - 3))
    begin, end = (at[:, 2:] + own * at[:, :2] for at in (each[:-1], each[1:]))
    carried = _apply(onward, each[:-1, :2]) + _apply(early, begin)
    return carried, each[1:, :2] - _apply(late, end)


def _apply(maps: Array, values: Array) -> Array:
    """Apply maps (K, m, 2, 2) to pairs (K, 2, m, …)."""
    return np.einsum("kmab,kbm...->kam...", maps, values)


def modal_values(modes: BeamModes, state: State) -> Array:
    """Modal amplitudes (K, 4, m, 3) of position, velocity, β and β̇ of nodes (K, N)."""
    rotation, nu, omega = state.pose[..., :3, :3], state.strain[..., :3], state.velocity[..., 3:]
    tangent = se3.rotate(rotation, nu)
    turning = se3.rotate(rotation, np.cross(omega, nu) + strain_rate_of(state)[..., :3])
    velocity = se3.rotate(rotation, state.velocity[..., :3])
    inertia = state.fields()[-1]
    place = modes.by_place @ state.pose[..., :3, 3] + modes.by_tangent @ tangent
    rate = modes.by_place @ velocity + modes.by_tangent @ turning
    return np.stack([place, rate, modes.fit @ inertia[..., :3], modes.fit @ inertia[..., 3:]], 1)


def modal_slopes(modes: BeamModes, state: State) -> Array:
    """Jacobian (K, 4, m, 3, N, 30) of `modal_values` by the nodes."""
    k_count, n_count = state.strain.shape[:2]
    rotation, nu = state.pose[..., :3, :3], state.strain[..., :3]
    velocity, omega = state.velocity[..., :3], state.velocity[..., 3:]
    turning = np.cross(omega, nu) + strain_rate_of(state)[..., :3]
    ones = np.broadcast_to(np.eye(3), rotation.shape)
    place, tangent, fit = modes.by_place, modes.by_tangent, modes.fit
    out = np.zeros((k_count, 4, modes.rate.size, 3, n_count, INERTIA.stop))
    for row, columns, weights, slope in (
        (0, _P, place, rotation),
        (0, _R, tangent, -rotation @ se3.hat3(nu)),
        (0, _NU, tangent, rotation),
        (1, _R, place, -rotation @ se3.hat3(velocity)),
        (1, _R, tangent, -rotation @ se3.hat3(turning)),
        (1, _V, place, rotation),
        (1, _W, tangent, -rotation @ se3.hat3(nu)),
        (1, _NU, tangent, rotation @ se3.hat3(omega)),
        (1, _NU_RATE, tangent, rotation),
        (2, slice(INERTIA.start, INERTIA.start + 3), fit, ones),
        (3, slice(INERTIA.start + 3, INERTIA.stop), fit, ones),
    ):
        out[:, row, :, :, :, columns] += np.einsum("mn,kncd->kmcnd", weights, slope)
    return out
