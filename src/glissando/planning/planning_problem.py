"""The planning problem: prior information over the horizon, and Jacobians of all readings.

The posterior covariance depends on the places of the readings, not on their values. Planning
therefore needs only the prior's information over the horizon, and the Jacobian of a reading at
every place and time. The estimator's own code computes both once. They are then reduced to the few
modes of the body's state that the sensor can measure, so that a path is evaluated in milliseconds.
Source: equations (8), (13), (20).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.noise import sqrt_information
from glissando.model.priors.transitions import symmetrize
from glissando.model.robot import Robot
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.short_repr import ShortRepr
from glissando.planning.belief import BeliefSource, ExpectedMotion, belief_of
from glissando.planning.modes import Modes, find_modes
from glissando.planning.prediction import PredictedInformation, Rows, look_ahead
from glissando.planning.sliding_sensor import SlidingSensor, sliding_sensor

_BETWEEN = 4  # places per arclength interval at which readings are linearised
_FEWEST = 6  # such places over the whole reach, at least
_ROUNDING = 0.1  # largest negative variance, in a reading's noise variance, taken for rounding
_TOUCH = 1e-9  # m, by which a path may leave the reach, for rounding
_SAME = 1e-9  # share of a step, by which time nodes may be closer, for rounding
_NODES = 100  # largest number of time steps by default


@dataclass(frozen=True)
class PlanningProblem(ShortRepr):
    """Reduced model of the planning horizon, with one reading in each step.

    Attributes:
        ahead: Information over the horizon at full size, before any reading in it.
        sensor: The sliding sensor.
        modes: Modes of the state that the sensor can measure.
        step: Duration of a step, s.
        steps: Number T of steps; the last time cell may extend beyond them.
        lattice: Evenly spaced arclengths (L,) of a coil at which readings are linearised, m.
        rows: Whitened Jacobians (T, L, r, 2 d) by the modes at both ends of the time cell, scaled
            to the information of all readings that the sensor takes in a step; T is rounded up to
            whole time cells here.
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
        """Time at which the first step begins, s."""
        return float(self.ahead.grid.time[0])

    @property
    def end(self) -> float:
        """Time at which the last step ends, s."""
        return self.start + self.steps * self.step

    @property
    def times(self) -> Array:
        """Midpoints (T,) of the steps in absolute time, s."""
        return np.asarray(self.start + (np.arange(self.steps) + 0.5) * self.step)

    @property
    def steps_per_cell(self) -> int:
        """Number of steps in a time cell."""
        return len(self.rows) // len(self.modes.pair)

    @property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest arclength of the first coil, m."""
        return float(self.lattice[0] + self.sensor.behind[-1]), float(self.lattice[-1])

    def require_path(self, arclength: ArrayLike) -> Array:
        """Check that a path can be evaluated, and return it as an array.

        Args:
            arclength: Arclengths (T,) of the first coil at `times`, m.

        Raises:
            GlissandoError: The arclengths are not T numbers, not finite, or outside the reach.
        """
        try:
            path, (low, high) = np.asarray(arclength, dtype=float), self.reach
        except (TypeError, ValueError):
            raise GlissandoError(
                f"A path is a {type(arclength).__name__}; give its arclengths ({self.steps},), m."
            ) from None
        if path.shape != (self.steps,) or not (
            low - _TOUCH <= path.min() and path.max() <= high + _TOUCH
        ):
            spread = f"{np.min(path, initial=np.inf):g} to {np.max(path, initial=-np.inf):g} m"
            raise GlissandoError(
                f"A path of {path.shape} arclengths from {spread} cannot be evaluated; give "
                f"({self.steps},), from {low:g} to {high:g} m."
            )
        return path

    @property
    def zone_times(self) -> Array:
        """Times (K−1,) at which zones are evaluated, s: the midpoints of the time cells."""
        nodes = self.ahead.grid.time
        return np.asarray(0.5 * (nodes[:-1] + np.minimum(nodes[1:], self.end)))

    def points(self, arclength: Array, time: Array) -> tuple[Index, Array, Array]:
        """Jacobians and prior covariances of the poses at points (M,) of the body.

        Returns:
            Indices (M,) of time cells, Jacobians (M, 6, 2 d) by the modes at both ends of the cell,
            and covariances (M, 6, 6) before any reading, in the body frame.
        """
        rows, bridge_cov = self.ahead.points(arclength, time)
        cov = rows.jacobian @ self.ahead.pairs(rows) @ rows.jacobian.mT + bridge_cov
        jacobian = np.empty((*rows.jacobian.shape[:2], self.modes.lift.shape[2]))
        for lower in np.unique(rows.lower):
            at = np.flatnonzero(rows.lower == lower)
            lift = self.modes.lift[:, self.ahead.corners(int(lower))]
            jacobian[at] = rows.jacobian[at] @ lift[rows.cell[at]]
        return rows.cell, jacobian, cov

    def predict(
        self, arclength: Array, prediction: PredictedInformation | None = None
    ) -> PredictedInformation:
        """Predict the estimator's information after a path, at full size.

        Args:
            arclength: Arclengths (T,) of the first coil at `times`, m.
            prediction: Information before the path; by default `ahead`.

        Raises:
            GlissandoError: The path has another number of steps, or leaves the reach.
        """
        arclength = self.require_path(arclength)
        times = self.sensor.reading_times(self.start, self.steps * self.step)
        place: Array = np.interp(times, self.times, arclength)
        return (prediction or self.ahead).after(self.sensor, place, times)


def predict_information(
    source: BeliefSource,
    reach: tuple[float, float],
    horizon: float,
    sensor: SlidingSensor | None = None,
    *,
    motion: ExpectedMotion | None = None,
    start: float = 0.0,
    step: float = 0.1,
    node_step: float | None = None,
) -> PlanningProblem:
    """Predict the prior information over a horizon, and the information of every possible reading.

    Args:
        source: A posterior, running smoother or belief, whose newest node is used, or a robot,
            whose prior is used.
        reach: Lowest and highest arclength of the first coil, m.
        horizon: Duration of the planning horizon, s.
        sensor: The sliding sensor; by default the coil of the robot file.
        motion: Expected motion; by default the robot holds its newest shape, or its rest shape.
        start: Start of the horizon for a robot, s.
        step: Duration of a step of a path, s.
        node_step: Approximate time between nodes, s, at least a step of a path; by default that of
            the estimate, but at most 100 intervals.

    Raises:
        GlissandoError: The reach leaves the body, the horizon is too short, `node_step` is shorter
            than a step or longer than the horizon, the prior is too wide to plan with, or an
            estimate comes without `sensor`.

    >>> from glissando import load_robot
    >>> predict_information(load_robot("sliding700"), (0.64, 0.7), 5.0).steps
    50
    """
    belief = belief_of(source, start)
    if sensor is None and isinstance(source, Robot):
        sensor = sliding_sensor(source)
    if sensor is None:
        raise GlissandoError("A posterior does not say what slides; give sensor=SlidingSensor(…).")
    _require_reach(reach, sensor, belief.arclength, horizon, step)
    steps = round(horizon / step)
    if node_step is None:
        node_step = max(belief.node_step, horizon / _NODES)
    elif not (1.0 - _SAME) * step <= node_step <= horizon:
        raise GlissandoError(
            f"Time nodes {node_step:g} s apart cannot be: they lie on the steps of a path, "
            f"{step:g} s each, of {horizon:g} s ahead; give {step:g} to {horizon:g} s."
        )
    steps_per_cell = max(1, round(node_step / step))
    cells = -(-steps // steps_per_cell)
    time = belief.time + steps_per_cell * step * np.arange(cells + 1)
    grid = Grid(belief.arclength, time, belief.previous_time)
    mean = belief.hold_shape(grid) if motion is None else motion(grid.time)
    parameters = EstimatedParameters(grid, belief.sensor_parameters)
    with one_thread():
        ahead = look_ahead(belief.prior, grid, mean, parameters, belief.information())
        lattice = _lattice(grid.arclength, reach[0] - sensor.behind[-1], reach[1])
        middle = np.full(lattice.size, grid.time[cells // 2])
        modes = find_modes(ahead.marginals, _node_rows(ahead, ahead.seen(sensor, lattice, middle)))
        rows = _reading_rows(ahead, modes, sensor, lattice, steps_per_cell)
    rows *= np.sqrt(step * sensor.rate)
    return PlanningProblem(ahead, sensor, modes, step, steps, lattice, rows)


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


def _lattice(nodes: Array, low: float, high: float) -> Array:
    """Evenly spaced arclengths (L,) of readings over the reach of the coils."""
    low, high = max(low, nodes[0]), min(high, nodes[-1])
    places = int(np.ceil(_BETWEEN * (high - low) / np.diff(nodes).min())) + 1
    return np.linspace(low, high, max(_FEWEST, places))


def _node_rows(ahead: PredictedInformation, rows: Rows) -> Array:
    """Jacobian (M · r, D) of readings at a time node with respect to that node."""
    wide = np.zeros((*rows.jacobian.shape[:2], 2 * ahead.size))
    for i, lower in enumerate(rows.lower):
        wide[i][:, ahead.corners(int(lower))] = rows.jacobian[i]
    return wide[..., : ahead.size].reshape(-1, ahead.size)


def _reading_rows(
    ahead: PredictedInformation, modes: Modes, sensor: SlidingSensor, lattice: Array, inside: int
) -> Array:
    """Whitened rows (cells · inside, L, r, 2 d) of one reading in every step at every place.

    If the robot holds its shape, all time cells share their Jacobians. The noise includes the
    uncertainty outside the modes, taken at the middle of the cell.
    """
    starts, cell = ahead.grid.time[:-1], ahead.grid.time[1] - ahead.grid.time[0]
    distinct = starts[:1] if ahead.still else starts
    offsets = np.append((np.arange(inside) + 0.5) / inside, 0.5) * cell
    at = distinct[:, None] + offsets
    rows = ahead.seen(sensor, np.tile(lattice, at.size), np.repeat(at.ravel(), lattice.size))
    jacobian = rows.jacobian.reshape(*at.shape, lattice.size, *rows.jacobian.shape[1:])
    lower = rows.lower[: lattice.size]
    r, d2 = jacobian.shape[-2], modes.lift.shape[2]
    out = np.empty((starts.size, inside, lattice.size, r, d2))
    for n in np.unique(lower):
        at_n = np.flatnonzero(lower == n)
        corners = ahead.corners(int(n))
        by_corner = jacobian[:, :, at_n]
        lifted = by_corner.reshape(len(distinct), -1, corners.size) @ modes.lift[:, corners]
        lifted = lifted.reshape(starts.size, inside + 1, at_n.size, r, d2)
        residual_cov = _covariance_given_modes(
            ahead, modes, by_corner[:, -1], lifted[:, -1], int(n)
        )
        out[:, :, at_n] = sqrt_information(np.eye(r) + residual_cov)[:, None] @ lifted[:, :-1]
    return out.reshape(-1, *out.shape[2:])


def _covariance_given_modes(
    ahead: PredictedInformation, modes: Modes, rows: Array, lifted: Array, lower: int
) -> Array:
    """Covariances (cells, M, r, r) of predicted readings given the modes.

    Raises:
        GlissandoError: The prior is so wide that the covariances are lost to rounding.
    """
    cells, (_, count, r, q) = len(modes.lift), rows.shape
    corners = Rows(np.arange(cells), np.full(cells, lower), np.empty((cells, 0, q)))
    flat = np.broadcast_to(rows, (cells, count, r, q)).reshape(cells, count * r, q)
    prior_cov = (flat @ ahead.pairs(corners)).reshape(cells, count, r, q) @ rows.mT
    modelled = (lifted.reshape(cells, count * r, -1) @ modes.pair).reshape(lifted.shape) @ lifted.mT
    residual_cov = symmetrize(prior_cov - modelled)
    if np.linalg.eigvalsh(residual_cov).min() < -_ROUNDING:
        widest = float(np.sqrt(np.einsum("kmii->kmi", prior_cov).max()))
        raise GlissandoError(
            f"Before any reading of the time ahead, one is uncertain by {widest:.2g} standard "
            f"deviations of its noise: too much to tell what another adds. Give the prior a firmer "
            f"base or strain, or plan on from an estimate."
        )
    return residual_cov
