"""What a rig makes a coil say, and how the errors of that go together.

The robot's shape is what motion capture alone shows of it; its errors, the tracker's bias and the
tube's play are covariances between readings, so that reading a place again is no news.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.rig import PARAMETERS, Rig, RigData
from glissando.calibration.rig.shape import shape_covariance
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.sensors import CoilReadings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Cholesky
from glissando.solver.measurement_factors import states_at

_NUDGE = 1e-6  # of every parameter, in SI units
ROWS = CoilReadings.rows


@dataclass(frozen=True)
class Model:
    """A coil's readings `data`, in the order of time, against the `shape` of the robot.

    `chol` is the factor of the shape's information. Every `bunch` readings, an odd number that
    followed each other closely, count as one by their mean: errors but the white ones are alike.
    """

    data: RigData
    shape: Posterior
    chol: Cholesky
    bunch: int = 1

    def at(self, bunches: NDArray[np.intp]) -> Model:
        """The model with some of the bunches."""
        rows = bunches[:, None] * self.bunch + np.arange(self.bunch)
        return replace(self, data=self.data.at(rows.ravel()))

    def where(self, rig: Rig) -> tuple[Array, Array]:
        """Arclength and time (M,) of the readings, which may be beyond the robot's ends."""
        time = rig.true_time(self.data.coil_time)
        return rig.arclength(time, self.data.slide_time, self.data.travel), time

    def _inside(self, arclength: Array, time: Array) -> tuple[Array, Array]:
        """The nearest places and times (M,) that the robot and its shape reach."""
        grid = self.shape.grid
        return np.clip(arclength, *grid.arclength[[0, -1]]), np.clip(time, *grid.time[[0, -1]])

    def states(self, rig: Rig) -> State:
        """The robot's states (M,) where the coil was."""
        return self._states(*self.where(rig))

    def _states(self, arclength: Array, time: Array) -> State:
        """The robot's states; beyond its ends it goes on as it is bent there.

        Were it cut off, a coil might be anywhere beyond, and all places there would be alike.
        """
        shape = self.shape
        inside, time = self._inside(arclength, time)
        found = states_at(shape.prior, shape.grid, shape.state, inside, time)
        beyond = (arclength - inside)[:, None] * found.strain
        return replace(found, pose=found.pose @ se3.exp(beyond))

    def readings(self, rig: Rig) -> CoilReadings:
        """The coil's readings in the world, by this rig."""
        arclength, time = self.where(rig)
        var = np.repeat(self.data.noise.coil**2, [3, 2])
        values = rig.T_wt @ self.data.coil
        return CoilReadings(
            time=time, arclength=arclength, values=values, cov=var, mount=rig.coil_mount
        )

    def residual(self, rig: Rig) -> Array:
        """Expected minus measured (B·5,) in the coil's frame, roll left out, by bunch."""
        return self._bunched(self.readings(rig).residual(self.states(rig)))

    def _bunched(self, rows: Array) -> Array:
        """Means (B·5,) over each bunch of rows (M, 5)."""
        return rows.reshape(-1, self.bunch, ROWS).mean(axis=1).ravel()

    def middles(self) -> Model:
        """The middle reading of every bunch alone."""
        rows = np.arange(self.bunch // 2, self.data.coil_time.size, self.bunch)
        return replace(self, data=self.data.at(rows), bunch=1)

    def jacobian(self, rig: Rig) -> Array:
        """Slopes (B·5, 17) of the residual by the rig's parameters, were readings without noise.

        Noise would turn the coil's axes this way and that, and pass for bends that show what is
        not to be seen. Slopes of the shape by arclength and time are found once and carried on by
        the chain rule; all are central differences.
        """
        arclength, time = self.where(rig)
        states = self._states(arclength, time)
        said = se3.inverse(rig.T_wt) @ states.pose @ rig.coil_mount
        ideal = replace(self, data=replace(self.data, coil=said))
        here = ideal.readings(rig)
        ends = [
            self._states(arclength + ds, time + dt)
            for ds, dt in _NUDGE * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        ]
        by_state = here.jacobian(states)
        by_place, by_time = (
            np.einsum("mrd,md->mr", by_state, ends[i].difference(ends[i + 1])) / (2.0 * _NUDGE)
            for i in (0, 2)
        )
        columns = []
        for nudge in _NUDGE * np.eye(len(PARAMETERS)):
            ahead, behind = (rig.moved(sign * nudge) for sign in (1.0, -1.0))
            moved = ideal.readings(ahead), ideal.readings(behind)
            change = moved[0].residual(states) - moved[1].residual(states)
            change += by_place * (moved[0].arclength - moved[1].arclength)[:, None]
            change += by_time * (moved[0].time - moved[1].time)[:, None]
            columns.append(self._bunched(change) / (2.0 * _NUDGE))
        return np.stack(columns, axis=-1)

    def covariance(self, rig: Rig) -> Array:
        """Covariance (B·5, B·5) of the residual at the true rig, as in each bunch's middle."""
        if self.bunch > 1:
            noise = replace(self.data.noise, coil=self.data.noise.coil / np.sqrt(self.bunch))
            middles = self.middles()
            return replace(middles, data=replace(middles.data, noise=noise)).covariance(rig)
        readings, states, noise = self.readings(rig), self.states(rig), self.data.noise
        arclength, time = self.where(rig)
        by_state = readings.jacobian(states)
        inside = self._inside(arclength, time)
        out = shape_covariance(self.shape, self.chol, *inside, by_state)
        size = len(time) * ROWS
        out[np.arange(size), np.arange(size)] += np.tile(readings.cov.diagonal(), len(time))
        place = self.data.coil[:, :3, 3]
        alike = _alike(place, float(noise.bias[2]))
        turn = (states.pose @ readings.mount)[:, :3, :3]
        turned = np.einsum("iab,jac->ijbc", turn, turn)  # of i's axes onto j's
        blocks = np.zeros((len(time), len(time), ROWS, ROWS))
        blocks[:, :, :3, :3] = noise.bias[0] ** 2 * alike[..., None, None] * turned
        blocks[:, :, 3:, 3:] = noise.bias[1] ** 2 * alike[..., None, None] * turned[..., :2, :2]
        blocks += _play(arclength, *(float(value) for value in noise.play))
        return out + blocks.transpose(0, 2, 1, 3).reshape(size, size)


def _alike(place: Array, length: float) -> Array:
    """Correlation (M, M) of a smooth random field between places (M, D)."""
    apart = place[:, None] - place[None]
    return np.exp(-0.5 * np.einsum("ijd,ijd->ij", apart, apart) / length**2)


def _play(arclength: Array, clearance: float, length: float) -> Array:
    """Covariance (M, M, 5, 5) of a tube that lies somewhere in another, and leans as it wanders.

    Offsets x and y are smooth random functions of arclength, tilts (−y′, x′).
    """
    apart = arclength[:, None] - arclength[None]
    alike = 0.5 * clearance**2 * np.exp(-0.5 * (apart / length) ** 2)
    slope = alike * apart / length**2  # of the second place
    both = alike * (1.0 - (apart / length) ** 2) / length**2
    out = np.zeros((*apart.shape, ROWS, ROWS))
    for axis, tilt, sign in ((0, 4, 1.0), (1, 3, -1.0)):
        out[..., axis, axis], out[..., tilt, tilt] = alike, both
        out[..., axis, tilt], out[..., tilt, axis] = sign * slope, -sign * slope
    return out
