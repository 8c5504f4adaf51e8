"""Prediction of a coil's readings from a rig's constants, and the covariance of their errors.

The robot's shape is estimated from motion capture alone. Errors of that shape, the tracker's bias
and the tube's clearance correlate readings, so repeated readings of a place add little information.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.channel import ChannelMap, by_strain_along
from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.shape import shape_covariance
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.sensors import CoilReadings
from glissando.model.state import State
from glissando.model.tendons.channel import Channel
from glissando.solver.block_tridiagonal import Cholesky
from glissando.solver.measurement_factors import states_at

_NUDGE = 1e-6  # step of finite differences of every parameter, in SI units
_IN_SPACE = PARAMETERS.index("zero")  # those before change poses; others, arclengths and times
ROWS = CoilReadings.rows


@dataclass(frozen=True)
class CoilModel:
    """A coil's readings against the shape of the robot.

    Attributes:
        data: The session, with coil readings in the order of time.
        shape: Posterior of the robot's shape given motion capture.
        chol: Cholesky factor of the posterior's information.
        block_size: Odd number of consecutive readings that are averaged into one, because they
            share all errors but white noise.
        maps: Cache of the maps from distance along a channel to arclength.
    """

    data: RigData
    shape: Posterior
    chol: Cholesky
    block_size: int = 1
    maps: dict[Channel, ChannelMap] = field(default_factory=dict, repr=False)

    def at(self, blocks: NDArray[np.intp]) -> CoilModel:
        """Model with the blocks at some indices."""
        rows = blocks[:, None] * self.block_size + np.arange(self.block_size)
        return replace(self, data=self.data.at(rows.ravel()))

    def points(self, rig: Rig) -> tuple[Array, Array]:
        """Arclengths and times (M,) of the readings, which may be beyond the robot's ends."""
        time = rig.true_time(self.data.coil_time)
        travel, channel = rig.arclength(time, self.data), rig.channel(self.data)
        if channel is None:
            return travel, time
        if channel not in self.maps:
            self.maps[channel] = ChannelMap.of(channel, self.shape)
        return self.maps[channel].place(travel, time), time

    def _inside(self, arclength: Array, time: Array) -> tuple[Array, Array]:
        """Arclengths and times (M,), clipped to the shape's grid."""
        grid = self.shape.grid
        return np.clip(arclength, *grid.arclength[[0, -1]]), np.clip(time, *grid.time[[0, -1]])

    def states(self, arclength: Array, time: Array) -> State:
        """States (M,) of the robot, extrapolated beyond its ends with the strain of the end.

        Without extrapolation, residuals beyond an end would not depend on arclength.
        """
        shape = self.shape
        inside, time = self._inside(arclength, time)
        state = states_at(shape.prior, shape.grid, shape.state, inside, time)
        beyond = (arclength - inside)[:, None] * state.strain
        return replace(state, pose=state.pose @ se3.exp(beyond))

    def readings(self, rig: Rig) -> CoilReadings:
        """The coil's readings in the world, at the arclengths and times of this rig."""
        arclength, time = self.points(rig)
        var = np.repeat(self.data.noise.coil**2, [3, 2])
        values = rig.T_wt @ self.data.coil
        return CoilReadings(
            time=time,
            arclength=arclength,
            values=values,
            cov=var,
            mount=rig.mount_at(arclength, self.data),
        )

    def expected(self, rig: Rig) -> tuple[CoilReadings, State]:
        """Readings rolled to match the predicted poses, and the robot's states (M,) at them."""
        readings = self.readings(rig)
        states = self.states(readings.arclength, readings.time)
        coil = replace(states, pose=states.pose @ readings.mount)
        roll = np.zeros((len(readings), 6))
        roll[:, 5] = coil.rolls_from(replace(states, pose=readings.values))
        return replace(readings, values=readings.values @ se3.exp(roll)), states

    def residual(self, rig: Rig) -> Array:
        """Predicted minus measured poses (B·5,) in the coil's frame without roll, block means."""
        readings, states = self.expected(rig)
        return self._block_means(readings.residual(states))

    def _block_means(self, rows: Array) -> Array:
        """Means (B·5,) of rows (M, 5) over each block."""
        return rows.reshape(-1, self.block_size, ROWS).mean(axis=1).ravel()

    def jacobian(self, rig: Rig) -> Array:
        """Jacobian (B·5, 17) of the residual with respect to the rig, at noise-free readings.

        At noisy readings, unobservable parameters would appear observable. Derivatives of the shape
        by arclength and time are computed once and enter by the chain rule; all are central
        differences.
        """
        arclength, time = self.points(rig)
        steps = _NUDGE * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])[:, :, None]
        points = (arclength + steps[:, 0]).ravel(), (time + steps[:, 1]).ravel()
        nearby = self.states(*points).reshape(len(steps), time.size)
        states, *ends = (nearby.take(k) for k in range(len(steps)))
        coil = se3.inverse(rig.T_wt) @ states.pose @ rig.mount_at(arclength, self.data)
        ideal = replace(self, data=replace(self.data, coil=coil))
        by_state = ideal.readings(rig).jacobian(states)
        by_arclength, by_time = (
            np.einsum("mrd,md->mr", by_state, ends[i].rise_from(ends[i + 1])) / (2.0 * _NUDGE)
            for i in (0, 2)
        )
        columns = []
        for k, nudge in enumerate(_NUDGE * np.eye(len(PARAMETERS))):
            ahead, behind = rig.moved(nudge), rig.moved(-nudge)
            change = np.zeros_like(by_time)
            if k < _IN_SPACE or self.data.channel is not None:
                readings = ideal.readings(ahead), ideal.readings(behind)
                change = readings[0].residual(states) - readings[1].residual(states)
            if k >= _IN_SPACE or self.data.channel is not None:
                (s_ahead, t_ahead), (s_behind, t_behind) = self.points(ahead), self.points(behind)
                change += by_arclength * (s_ahead - s_behind)[:, None]
                change += by_time * (t_ahead - t_behind)[:, None]
            columns.append(self._block_means(change) / (2.0 * _NUDGE))
        return np.stack(columns, axis=-1)

    def covariance(self, rig: Rig) -> Array:
        """Covariance (B·5, B·5) of the residual at the true rig, at each block's middle reading."""
        if self.block_size > 1:
            rows = np.arange(self.block_size // 2, self.data.coil_time.size, self.block_size)
            noise = replace(self.data.noise, coil=self.data.noise.coil / np.sqrt(self.block_size))
            middles = replace(self.data.at(rows), noise=noise)
            return replace(self, data=middles, block_size=1).covariance(rig)
        (readings, states), noise = self.expected(rig), self.data.noise
        arclength, time = readings.arclength, readings.time
        by_state = readings.jacobian(states)
        inside = self._inside(arclength, time)
        along = self._by_strain(rig, by_state)
        out = shape_covariance(self.shape, self.chol, *inside, by_state, along)
        size = len(time) * ROWS
        out[np.arange(size), np.arange(size)] += np.tile(readings.cov.diagonal(), len(time))
        correlation = _field_correlation(self.data.coil[:, :3, 3], float(noise.bias[2]))
        R = (states.pose @ readings.mount)[:, :3, :3]
        relative = np.einsum("iab,jac->ijbc", R, R)  # of i's axes onto j's
        blocks = _clearance_covariance(arclength, *(float(value) for value in noise.play))
        for part, std in ((slice(0, 3), noise.bias[0]), (slice(3, 5), noise.bias[1])):
            axes = slice(0, part.stop - part.start)
            field = std**2 * correlation[..., None, None] * relative[..., axes, axes]
            blocks[:, :, part, part] += field
        return out + blocks.transpose(0, 2, 1, 3).reshape(size, size)

    def _by_strain(self, rig: Rig, by_state: Array) -> Array | None:
        """Jacobians (M, r, N·dof) through the coil's arclength in a channel; None without one."""
        channel = rig.channel(self.data)
        if channel is None:
            return None
        arclength, time = self.points(rig)
        ends = [self.states(arclength + step, time) for step in (_NUDGE, -_NUDGE)]
        rise = ends[0].rise_from(ends[1]) / (2.0 * _NUDGE)
        travel = rig.arclength(time, self.data)
        placed = self.readings(rig)
        readings = replace(
            placed, arclength=travel, mount=rig.whole_mount(self.data), channel=channel
        )
        return by_strain_along(self.shape, readings, by_state, rise)


def _field_correlation(place: Array, length: float) -> Array:
    """Correlation (M, M) of a smooth random field between places (M, 3)."""
    difference = place[:, None] - place[None]
    return np.exp(-0.5 * np.einsum("ijd,ijd->ij", difference, difference) / length**2)


def _clearance_covariance(arclength: Array, clearance: float, length: float) -> Array:
    """Covariance (M, M, 5, 5) of the offset and tilt of a tube within another one.

    Offsets x and y are smooth random functions of arclength; tilts are (−y′, x′).
    """
    difference = arclength[:, None] - arclength[None]
    offset = 0.5 * clearance**2 * np.exp(-0.5 * (difference / length) ** 2)
    slope = offset * difference / length**2  # of the second place
    both_slopes = offset * (1.0 - (difference / length) ** 2) / length**2
    out = np.zeros((*difference.shape, ROWS, ROWS))
    for axis, tilt, sign in ((0, 4, 1.0), (1, 3, -1.0)):
        out[..., axis, axis], out[..., tilt, tilt] = offset, both_slopes
        out[..., axis, tilt], out[..., tilt, axis] = sign * slope, -sign * slope
    return out
