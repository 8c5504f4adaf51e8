"""What a path will be worth: the time ahead in few numbers, and every reading it could take.

Where a sensor goes changes what is known; what it reads does not. So all that planning needs is the
prior's information over the time ahead, and the Jacobian of a reading at every place and time. Both
are made once by the estimator's own code, and carried over to the few modes of the body's shape
that a sensor can tell, so that a path is judged in milliseconds. Source: equations (8), (13), (20).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.noise import sqrt_information
from glissando.model.priors.transitions import symmetrize
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import EstimatedParameters
from glissando.planning.belief import Belief, ExpectedMotion, belief_of
from glissando.planning.modes import Modes, near_in_time, reduced, telling_weights
from glissando.planning.prediction import PredictedInformation, Rows, look_ahead
from glissando.planning.sliding_sensor import SlidingSensor, sliding_sensor
from glissando.twins import estimating

_BETWEEN = 4  # places between two arclength nodes at which readings are linearised
_FEWEST = 6  # of them over the whole reach
_LEAST, _MOST = 0.1, 32  # standard deviations of a reading that modes may leave; modes at most
_ROUNDING = 0.1  # of a reading's variance that may be lost to it
_NODES = 100  # time steps of the grid ahead, if the estimate's are finer


@dataclass(frozen=True)
class PlanningProblem:
    """The time ahead as a planner sees it.

    `ahead` is all of it, `modes` what a sensor can tell of it. A reading is taken in the middle of
    each of `steps` of `step` seconds at one of the places `lattice` (L,), evenly spaced: `rows`
    (T, L, r, 2 d) are its whitened Jacobians, worth as many readings as the sensor takes in a step.
    The last time cell may have steps to spare.
    """

    ahead: PredictedInformation
    sensor: SlidingSensor
    modes: Modes
    step: float
    steps: int
    lattice: Array
    rows: Array

    @property
    def start(self) -> float:
        """When it begins, seconds."""
        return float(self.ahead.grid.time[0])

    @property
    def times(self) -> Array:
        """Middles (T,) of the steps, seconds."""
        return np.asarray(self.start + (np.arange(self.steps) + 0.5) * self.step)

    @property
    def last(self) -> float:
        """Time at which the last step ends, seconds."""
        return self.start + self.steps * self.step

    def points(self, arclength: Array, time: Array) -> tuple[Index, Array, Array]:
        """Time cells (M,), rows (M, 6, 2 d) and covariance (M, 6, 6) before any reading."""
        rows, left = self.ahead.points(arclength, time)
        cov = rows.jacobian @ self.ahead.pairs(rows) @ _transposed(rows.jacobian) + left
        return rows.cell, self._lifted(rows), cov

    def _lifted(self, rows: Rows) -> Array:
        """The rows (M, r, 2 d) as functions of the modes."""
        out = np.empty((*rows.jacobian.shape[:2], self.modes.lift.shape[2]))
        for lower in np.unique(rows.lower):
            at = np.flatnonzero(rows.lower == lower)
            lift = self.modes.lift[:, self.ahead.corners(int(lower))]
            out[at] = rows.jacobian[at] @ lift[rows.cell[at]]
        return out

    @property
    def inside(self) -> int:
        """Steps in a time cell."""
        return len(self.rows) // len(self.modes.pair)

    @property
    def middles(self) -> Array:
        """Middles (K−1,) of the time cells as far as the time ahead reaches, where zones count."""
        nodes = self.ahead.grid.time
        return np.asarray(0.5 * (nodes[:-1] + np.minimum(nodes[1:], self.last)))

    def told(
        self, arclength: Array, known: PredictedInformation | None = None
    ) -> PredictedInformation:
        """What the estimator will know after a path (T,), at full size, a reading at a time.

        Before it, `known` is; all that is known of the time ahead unless given.
        """
        lasts = self.steps * self.step
        count = max(1, round(lasts * self.sensor.rate))
        time = np.asarray(self.start + (np.arange(count) + 0.5) * (lasts / count))
        place: Array = np.interp(time, self.times, arclength)
        return (known or self.ahead).after(self.sensor, place, time)


def predict_information(
    known: Robot | Posterior | FixedLagSmoother | Belief,
    reach: tuple[float, float],
    horizon: float,
    sensor: SlidingSensor | None = None,
    *,
    course: ExpectedMotion | None = None,
    start: float = 0.0,
    step: float = 0.1,
    node_step: float | None = None,
) -> PlanningProblem:
    """What is known of the next `horizon` seconds, and what a sensor could add to it.

    `known` is a robot (its prior alone, from time `start` on), or a posterior, running smoother or
    snapshot: all that it knows at its newest time. The first coil moves between the arclengths
    `reach`, m. The robot holds its shape (that at rest, or that of the newest time) unless `course`
    says how it moves. `step` is that of paths, `node_step` about that of the estimate's time nodes:
    by default what it was, unless that makes more than 100. Raises GlissandoError for what cannot
    be.

    >>> from glissando import load_robot
    >>> predict_information(load_robot("sliding700"), (0.64, 0.7), 5.0).steps
    50
    """
    now = belief_of(known, start)
    if sensor is None and isinstance(known, Robot):
        sensor = sliding_sensor(known)
    if sensor is None:
        raise GlissandoError("A posterior does not say what slides; give sensor=SlidingSensor(…).")
    _require_reach(reach, sensor, now.arclength, horizon, step)
    steps = round(horizon / step)
    if node_step is None:
        node_step = max(now.node_step, horizon / _NODES)
    if not node_step > 0.0:
        raise GlissandoError(f"With time nodes {node_step:g} s apart there is no end; give more.")
    inside = max(1, round(node_step / step))
    cells = -(-steps // inside)
    grid = Grid(now.arclength, now.time + inside * step * np.arange(cells + 1), now.before)
    mean = now.held(grid) if course is None else course(grid.time)
    with estimating():
        ahead = look_ahead(
            now.prior, grid, mean, EstimatedParameters(grid, now.sensor_parameters), now.belief()
        )
        return _seen(ahead, sensor, reach, step, steps, inside)


def _require_reach(
    reach: tuple[float, float], sensor: SlidingSensor, arclength: Array, horizon: float, step: float
) -> None:
    low, high = reach[0] - sensor.behind[-1], reach[1]
    if not (arclength[0] - 1e-9 <= low and reach[0] < high <= arclength[-1] + 1e-9):
        raise GlissandoError(
            f"The sensor would slide from {low:g} to {high:g} m on a body from {arclength[0]:g} to "
            f"{arclength[-1]:g} m; shorten the stroke or bring the coils closer."
        )
    if not (np.isfinite(horizon) and 0.0 < 2.0 * step <= horizon * (1.0 + 1e-9)):
        raise GlissandoError(
            f"{horizon:g} s ahead in steps of {step:g} s cannot be planned; give two steps or more."
        )


def _seen(
    ahead: PredictedInformation,
    sensor: SlidingSensor,
    reach: tuple[float, float],
    step: float,
    steps: int,
    inside: int,
) -> PlanningProblem:
    """The outlook: modes from readings everywhere, then every reading as a function of them."""
    nodes = ahead.grid.arclength
    low, high = max(reach[0] - sensor.behind[-1], nodes[0]), min(reach[1], nodes[-1])
    places = max(_FEWEST, int(np.ceil(_BETWEEN * (high - low) / np.diff(nodes).min())) + 1)
    lattice = np.linspace(low, high, places)
    cells = len(ahead.grid.time) - 1
    middle = cells // 2
    at = ahead.seen(sensor, lattice, np.full(places, ahead.grid.time[middle]))
    wide = np.zeros((*at.jacobian.shape[:2], 2 * ahead.size))
    for i, lower in enumerate(at.lower):
        wide[i][:, ahead.corners(int(lower))] = at.jacobian[i]
    cov = ahead.marginals.cov[middle]
    own = wide[..., : ahead.size].reshape(-1, ahead.size)
    telling = near_in_time(ahead.marginals, middle, own)
    modes = reduced(ahead.marginals, telling_weights(cov, telling, _LEAST, _MOST))
    rows = _reading_rows(ahead, modes, sensor, lattice, step, inside)
    scale = np.sqrt(step * sensor.rate)
    return PlanningProblem(ahead, sensor, modes, step, steps, lattice, scale * rows)


def _reading_rows(
    ahead: PredictedInformation,
    modes: Modes,
    sensor: SlidingSensor,
    lattice: Array,
    step: float,
    inside: int,
) -> Array:
    """Whitened rows (cells · inside, L, r, 2 d) of one reading in every step at every place.

    Where the robot holds still, all time cells are alike but for what is known in them. What modes
    leave uncertain widens the noise, as it is in the middle of the cell.
    """
    starts = ahead.grid.time[:-1]
    moving = starts[:1] if ahead.still else starts
    offsets = np.append((np.arange(inside) + 0.5) * step, 0.5 * inside * step)
    time = (moving[:, None, None] + offsets[:, None] + 0.0 * lattice).ravel()
    found = ahead.seen(
        sensor, np.broadcast_to(lattice, (moving.size * offsets.size, lattice.size)).ravel(), time
    )
    shape = moving.size, offsets.size, lattice.size
    jacobian = found.jacobian.reshape(*shape, *found.jacobian.shape[1:])
    lower = found.lower.reshape(shape)[0, 0]
    r, d2 = jacobian.shape[-2], modes.lift.shape[2]
    out = np.empty((starts.size, inside, lattice.size, r, d2))
    for n in np.unique(lower):
        at = np.flatnonzero(lower == n)
        corners = ahead.corners(int(n))
        mine = jacobian[:, :, at]
        lifted = (mine.reshape(moving.size, -1, corners.size) @ modes.lift[:, corners]).reshape(
            starts.size, offsets.size, at.size, r, d2
        )
        open_ = np.eye(r) + _left(ahead, modes, mine[:, -1], lifted[:, -1], int(n))
        out[:, :, at] = sqrt_information(open_)[:, None] @ lifted[:, :-1]
    return out.reshape(starts.size * inside, lattice.size, r, d2)


def _left(
    ahead: PredictedInformation, modes: Modes, rows: Array, lifted: Array, lower: int
) -> Array:
    """Covariance (cells, M, r, r) of readings that the modes leave open."""
    cells, (_, count, r, q) = len(modes.lift), rows.shape
    index = np.arange(cells)
    pairs = ahead.pairs(Rows(index, np.full(cells, lower), np.empty((cells, 0, q))))
    flat = np.broadcast_to(rows, (cells, count, r, q)).reshape(cells, count * r, q)
    whole = (flat @ pairs).reshape(cells, count, r, q) @ _transposed(rows)
    kept = (lifted.reshape(cells, count * r, -1) @ modes.pair).reshape(lifted.shape)
    left = symmetrize(whole - kept @ _transposed(lifted))
    if np.linalg.eigvalsh(left).min() < -_ROUNDING:
        widest = float(np.sqrt(np.einsum("kmii->kmi", whole).max()))
        raise GlissandoError(
            f"Before any reading of the time ahead, one is uncertain by {widest:.2g} standard "
            f"deviations of its noise: too much to tell what another adds. Give the prior a firmer "
            f"base or strain, or plan on from an estimate."
        )
    return left


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)
