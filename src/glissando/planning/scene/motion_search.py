"""The search for a motion of least cost at a bounded risk, from one that is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from glissando.errors import NoShapeError
from glissando.geometry.se3 import Array
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem

_FAR = 10.0  # of the cost, a constraint missed by its own size
_WITHIN = 0.9  # of what the tip may miss a target by, squared, that a plan aims at
_CLOSE = 1e-5  # of the cost, that an iteration must gain


@dataclass
class Search:
    """A search for the motion of least cost whose bound of the risk is below `allowed`.

    Sequential quadratic programming: the limits of the actuators are linear, the risk and the
    distances from the targets are constraints. Source: Kraft 1988, as scipy has it.

    Attributes:
        problem: The problem.
        allowed: What the bound of the risk is held below.
        free: Which actuators (C,) may change their paths; all unless given.
        last: What was evaluated last.
    """

    problem: MotionProblem
    allowed: float
    free: NDArray[np.bool_] | None = None
    last: Evaluation | None = None

    def merit(self, at: Evaluation) -> float:
        """Cost and how far the constraints are missed."""
        over = max(0.0, self.problem.log_risk(at) - float(np.log(self.allowed)))
        far = np.maximum(np.sqrt(self.problem.misses(at)) - 1.0, 0.0)
        return at.cost + _FAR * (over + float(far.sum()))

    def value(self, control: Array) -> float:
        """The merit of a motion; infinite where the robot has no shape."""
        try:
            return self.merit(self.at(control))
        except NoShapeError:
            return np.inf

    def at(self, control: Array) -> Evaluation:
        """What a motion is worth; that of the last one if it is the same."""
        if self.last is None or not np.array_equal(control, self.last.control):
            self.last = self.problem.evaluate(control, self.last)
        return self.last

    def improve(self, control: Array, iterations: int) -> Evaluation:
        """The best motion that the search leads to."""
        problem, space = self.problem, self.problem.space
        rows, centre, width = space.polytope
        edges, ends = (
            np.concatenate([rows, -rows]),
            np.concatenate([width + centre, width - centre]),
        )
        limit = float(np.log(self.allowed))

        def at(free: Array) -> Evaluation:
            return self.at(space.control(free))

        def gaps(free: Array) -> Array:
            return np.append(_WITHIN - problem.misses(at(free)), limit - problem.log_risk(at(free)))

        def gap_slopes(free: Array) -> Array:
            e = at(free)
            return -np.vstack([problem.misses_gradient(e), problem.log_risk_gradient(e)])

        constraints = [
            {"type": "ineq", "fun": lambda x: ends - edges @ x, "jac": lambda x: -edges},
            {"type": "ineq", "fun": gaps, "jac": gap_slopes},
        ]
        begin = self.at(control)
        low, high = space.bounds
        first = np.clip(space.free(control), low, high)
        if self.free is not None:
            held = np.repeat(~self.free, space.size // self.free.size)
            low, high = np.where(held, first, low), np.where(held, first, high)
        try:
            found = minimize(
                lambda x: at(x).cost, first, method="SLSQP",
                bounds=np.stack([low, high], axis=-1), constraints=constraints,
                jac=lambda x: problem.cost_gradient(at(x)),
                options={"maxiter": iterations, "ftol": _CLOSE},
            )  # fmt: skip
        except NoShapeError:  # a trial step bent the robot beyond what has a shape
            return begin
        new = space.control(found.x)
        if np.any(edges @ found.x > ends + 1e-9):  # rounding of the quadratic programs
            new = space.follow(new)
        return min((self.at(new), begin), key=self.merit)
