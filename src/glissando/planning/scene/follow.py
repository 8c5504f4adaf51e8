"""A plan followed in a loop: readings tell of the model error, and commands correct for it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import NoShapeError
from glissando.geometry.se3 import Array
from glissando.model.noise import sqrt_information
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.planning.scene.error_belief import ErrorBelief
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.plan_motion import MotionPlan
from glissando.planning.scene.tendon_body import BodyShapes

_STEPS = 4  # of Gauss and Newton towards the planned bends
_EASE = 1e-3  # of the largest curvature by displacement, below which tendons are left alone


@dataclass
class MotionFollower:
    """What a control loop asks for commands, and tells what sensors read.

    Commands bend every piece as the plan does, given what is known of the model error by then. The
    plan ends at rest, and commands never leave the limits of the actuators, so a loop that stops
    giving readings still ends safely.

    Attributes:
        plan: The plan.
        belief: What is known of the model error, at the time of the newest reading.
        time: That time, s from the plan's start.
        pulled: Displacements (T,) that the tendons were last told, m.
        due: When they are there, s.
    """

    plan: MotionPlan
    belief: ErrorBelief = field(init=False)
    time: float = 0.0
    pulled: Array = field(init=False)
    due: float = 0.0
    _before: tuple[float, Array] = field(init=False)

    def __post_init__(self) -> None:
        self.belief = self.plan.problem.belief
        self.pulled = np.array([tendon.start for tendon in self.problem.scene.tendons])
        self._before = -np.inf, self.pulled

    @property
    def problem(self) -> MotionProblem:
        """The problem that the plan solves."""
        return self.plan.problem

    def planned(self, time: float) -> Array:
        """Values (C,) of all actuators that the plan has at a time, m; at rest after its end."""
        moment = np.array([np.clip(time, 0.0, self.problem.scene.horizon)])
        basis = replace(self.problem.space, moments=moment).basis
        return np.asarray((basis @ self.plan.evaluation.control.T)[0])

    def advance(self, time: float) -> None:
        """Let time pass, s from the plan's start, without readings."""
        self.belief = self.belief.after(time - self.time, self.problem.body.time_scale)
        self.time = time

    def add(self, readings: Readings) -> None:
        """Take readings of a coil at times of the plan, m and s.

        Between two commands the tendons move evenly. Source: the extended Kalman filter; a batch
        is linearised where the robot is expected, and its readings count as of the newest time.
        """
        (first, start), count = self._before, len(readings)
        share = np.clip((readings.time - first) / max(self.due - first, 1e-9), 0.0, 1.0)
        with one_thread():
            pulled = start + share[:, None] * (self.pulled - start)
            shapes = self.problem.body.shapes(pulled, np.tile(self.belief.mean, (count, 1)))
            at, weights = self.problem.neighbours(readings.arclength)
            own = np.arange(count)
            twist = shapes.body_twist[own[:, None], at]
            twist = np.einsum("mn,mniq->miq", weights[:, 0], twist)
            pose = shapes.pose_at(readings.arclength)[own, own]
            state = State(pose, np.zeros((count, 6)), np.zeros((count, 6)))
            white = sqrt_information(readings.cov)
            rows = white @ readings.jacobian(state)[..., :6] @ twist
            residual = -(white @ readings.residual(state)[..., None])
            size = rows.shape[-1]
            self.belief = self.belief.updated(rows.reshape(-1, size), residual.ravel())

    def command(self, time: float) -> Array:
        """Values (C,) that all actuators should have come to by a time, s from the start, m.

        Where the planned bends have no shape any more, the tendons stay as they are.
        """
        values, count = self.planned(time), self.pulled.size
        self._before = (self.due, self.pulled) if time > 0.0 else (-1.0, self.pulled)
        self.due = time
        scale = self.problem.body.time_scale
        start = self.problem.belief.after(time, scale).mean
        mean = self.belief.after(max(time - self.time, 0.0), scale).mean
        with one_thread():
            try:
                wished = self.problem.body.shapes(values[None, :count], start[None])
                self.pulled = self._bent_as(wished, values[:count], mean)
            except NoShapeError:
                pass
        return np.concatenate([self.pulled, values[count:]])

    def _bent_as(self, wished: BodyShapes, pulled: Array, error: Array) -> Array:
        """Displacements (T,) nearest to given ones that bend all pieces as wished."""
        tendons = self.problem.scene.tendons
        low, high = (np.array([getattr(t, end) for t in tendons]) for end in ("lower", "upper"))
        goal, at = wished.balance.strain[0, :, 3:5].ravel(), pulled
        for _ in range(_STEPS):
            here = self.problem.body.shapes(at[None], error[None]).balance
            slope = here.strain_by_displacement()[0, :, 3:5].reshape(goal.size, -1)
            off = goal - here.strain[0, :, 3:5].ravel()
            at = np.clip(at + np.linalg.pinv(slope, rcond=_EASE) @ off, low, high)
        return at
