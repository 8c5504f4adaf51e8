"""Execution of a plan in a control loop: commands corrected by the estimated model error."""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.geometry.se3 import Array
from glissando.model.noise import sqrt_information
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.plan_motion import MotionPlan
from glissando.planning.scene.tendon_body import BodyShapes

_STEPS = 4  # Gauss–Newton steps towards the planned bends
_EASE = 1e-3  # regularisation over the largest singular value of the bends' Jacobian
_ABSURD = 10.0  # gate: RMS innovation, in standard deviations, of a reading that is rejected
_LONGEST = 10.0  # s, or the plan's duration if longer: larger time steps are refused as errors
_ROOM = 1e-9  # m, least width of the bounds of a displacement


@dataclass
class MotionFollower:
    """Commands for a control loop that follows a plan, corrected by sensor readings.

    Commands bend every piece as planned, given the current estimate of the model error. The plan
    ends at rest, and commands never exceed the actuators' limits of stroke and speed, so a loop
    whose readings stop still ends safely. Corrections are truncated at these limits.

    Attributes:
        plan: The plan.
        begins_with: Initial belief about the model error; by default that of the plan.
        time: Time of the belief, s from the plan's start.
        due: Time for which the newest command is meant, s from the plan's start.
        belief: Belief about model error and sensor errors at `time`.
        dropped: Number of readings that were not used.
    """

    plan: MotionPlan
    begins_with: InitVar[ErrorBelief | None] = None
    time: float = 0.0
    due: float = 0.0
    belief: ErrorBelief = field(init=False)
    dropped: int = field(default=0, init=False)
    _begun: float = field(default=-1.0, init=False)
    _corrections: Array = field(init=False)  # (2, T) of the previous and the newest command, m

    def __post_init__(self, begins_with: ErrorBelief | None) -> None:
        self.belief = begins_with or self.plan.problem.belief
        self._corrections = np.zeros((2, len(self.problem.scene.tendons)))

    @property
    def problem(self) -> MotionProblem:
        """The problem that the plan solves."""
        return self.plan.problem

    def planned(self, time: ArrayLike) -> Array:
        """Planned values (…, C) of all actuators at times (…), s, in m; at rest after the end."""
        moment = np.clip(np.asarray(time, dtype=float), 0.0, self.problem.scene.horizon)
        basis = self.problem.space.basis_at(moment.ravel())
        values = basis @ self.plan.evaluation.control.T
        return np.asarray(values.reshape(*moment.shape, -1))

    def at(self, time: ArrayLike) -> Array:
        """Commanded values (…, C) of all actuators, m, at times (…), s, up to the newest command.

        They are the planned ones plus a correction that is linear between two commands.
        """
        when, values = np.asarray(time, dtype=float), self.planned(time)
        share = np.clip((when - self._begun) / max(self.due - self._begun, 1e-9), 0.0, 1.0)
        before, now = self._corrections
        count = now.size
        pulled = values[..., :count] + before + share[..., None] * (now - before)
        values[..., :count] = np.clip(pulled, *self._limits)
        return values

    def advance(self, time: float) -> None:
        """Predict the belief to a time, s from the plan's start; earlier times change nothing.

        Raises:
            GlissandoError: The time differs from the last by more than the plan's duration.
        """
        self._require_time(time)
        if time <= self.time:
            return
        self.belief = self.belief.after(time - self.time, self.problem.time_scale)
        self.time = time

    def add(self, readings: Readings) -> None:
        """Update the belief with raw readings of one sensor; times in s from the plan's start.

        Sensor parameters are applied, including known ones. With several sensors, the readings'
        name identifies the sensor.

        Readings at arclengths off the robot and outliers are rejected and counted in `dropped`. The
        gate is wide, since a robot always deviates from its model.

        Source: the extended Kalman filter; a batch is linearised at the expected shapes, and its
        readings are all assigned to the belief's `time`.
        """
        on = (readings.arclength >= 0.0) & (readings.arclength <= self.problem.body.arclength[-1])
        self.dropped += int(np.sum(~on))
        readings, count = readings.select(on), int(np.sum(on))
        if not count:
            return
        streams = {sensor.name for sensor in self.problem.scene.sensors}
        if readings.name not in streams and len(streams) == 1:
            readings = readings.changed(name=min(streams))
        readings = self.problem.sensed.expected(readings)
        with one_thread():
            pulled = self.at(readings.time)[:, : self._corrections.shape[1]]
            body, mean = self.problem.body, self.belief.mean
            shapes = body.shapes(pulled, np.tile(mean[: body.errors], (count, 1)))
            at, weights = self.problem.neighbours(readings.arclength)
            sample = np.arange(count)
            twist = shapes.body_twist_at(sample[:, None], at)
            twist = np.einsum("mn,mniq->miq", weights[:, 0], twist)
            pose = shapes.pose_at(readings.arclength)[sample, sample]
            state = State(pose, np.zeros((count, 6)), np.zeros((count, 6)))
            white = sqrt_information(readings.cov)
            by_state = readings.jacobian(state)
            repeated = self.problem.sensed.slopes(readings, state, by_state)
            expected_residual = readings.residual(state) + repeated @ mean[body.errors :]
            rows = white @ np.concatenate([by_state[..., :6] @ twist, repeated], axis=-1)
            residual = -(white @ expected_residual[..., None])
            size = rows.shape[-1]
            innovation_cov = np.eye(rows.shape[1]) + rows @ self.belief.cov @ rows.mT
            squared = np.sum(
                residual[..., 0] * np.linalg.solve(innovation_cov, residual)[..., 0], axis=-1
            )
            likely = squared < _ABSURD**2 * rows.shape[1]
            self.dropped += int(np.sum(~likely))
            rows, residual = rows[likely].reshape(-1, size), residual[likely].ravel()
            self.belief = self.belief.updated(rows, residual)

    def command(self, time: float) -> Array:
        """Command: values (C,) that all actuators should reach at a time, s from the start, in m.

        If no equilibrium with the planned bends is found, the last correction is kept. Tendons keep
        their speed limits; if one would exceed its limit, others make the correction if they can.

        Raises:
            GlissandoError: The time differs from the last by more than the plan's duration.
        """
        self._require_time(time)
        values, count = self.planned(time), self._corrections.shape[1]
        since, size = max(time - self.time, 0.0), self.problem.body.errors
        start = self.problem.expected(time)
        mean = self.belief.after(since, self.problem.time_scale).mean[:size]
        pulled, before = values[:count], self._corrections[1]
        low, high = np.clip(
            pulled + before + self._correction_bounds(min(self.due, time), time), *self._limits
        )
        new = before
        with one_thread():
            try:
                wished = self.problem.body.shapes(pulled[None], start[None])
                new = self._displacements_for(wished, pulled, mean, (low, high)) - pulled
            except GlissandoError:
                pass
        self._begun = self.due if time > self.due else time - 1.0
        self._corrections, self.due = np.stack([before, new]), time
        return self.at(time)

    def _require_time(self, time: float) -> None:
        """Raise GlissandoError for a time step longer than the plan, probably in another unit."""
        longest = max(self.problem.scene.horizon, _LONGEST)
        ended = self.due >= self.problem.scene.horizon and 0.0 <= time < np.inf  # at rest
        if not (ended or abs(time - max(self.time, self.due)) <= longest):
            raise GlissandoError(
                f"The time goes from {self.due:g} to {time:g} s within a plan of "
                f"{self.problem.scene.horizon:g} s; give seconds from its start."
            )

    def _correction_bounds(self, begin: float, end: float) -> Array:
        """Least and largest changes (2, T) of the corrections between two times, m.

        The speed limits less the planned speeds, which are linear between the knots of the splines.
        """
        path, tendons = self.problem.space.paths[0], self.problem.scene.tendons
        knots = path.step * np.arange(path.steps + 1)
        times = [begin, *knots[(knots > begin) & (knots < end)], end]
        moves = np.diff(self.plan.evaluation.control[: len(tendons)], axis=1) / path.step
        speed = np.array([np.interp(times, knots, row) for row in moves])
        limit = np.array([tendon.speed for tendon in tendons])
        least = np.minimum(-limit - speed.min(axis=1), 0.0)
        most = np.maximum(limit - speed.max(axis=1), 0.0)
        return (end - begin) * np.stack([least, most])

    @property
    def _limits(self) -> tuple[Array, Array]:
        """Least and largest displacements (T,), m."""
        tendons = self.problem.scene.tendons
        return np.array([t.lower for t in tendons]), np.array([t.upper for t in tendons])

    def _displacements_for(
        self, wished: BodyShapes, pulled: Array, error: Array, limits: tuple[Array, Array]
    ) -> Array:
        """Displacements (T,) within limits that bend all pieces as wished, nearest to `pulled`.

        Source: Gauss–Newton steps, each a least-squares problem with bounds (Stark and Parker,
        1995), with a small penalty on the distance from the given displacements.
        """
        low, high = limits[0], np.maximum(limits[1], limits[0] + _ROOM)
        goal, at = wished.balance.strain[0, :, 3:5].ravel(), np.clip(pulled, low, high)
        for _ in range(_STEPS):
            equilibrium = self.problem.body.shapes(at[None], error[None]).balance
            slope = equilibrium.strain_by_displacement()[0, :, 3:5].reshape(goal.size, -1)
            damping = _EASE * np.linalg.norm(slope, ord=2)
            rows = np.vstack([slope, damping * np.eye(at.size)])
            misfit = np.append(
                goal - equilibrium.strain[0, :, 3:5].ravel(), damping * (pulled - at)
            )
            step = lsq_linear(rows, misfit, (low - at - _ROOM, high - at + _ROOM), method="bvls").x
            at = np.clip(at + step, low, high)
        return at
