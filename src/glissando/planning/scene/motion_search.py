"""Local search for a motion of least cost at bounded risk, from a given motion.

A motion is evaluated when commands are corrected, and also in between if a place near an obstacle
would move too far from one moment to the next, so that no collision is overlooked.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from glissando.errors import NoShapeError
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem

_FAR = 10.0  # penalty per unit of constraint violation
_WITHIN = 0.99  # squared distance from a target over squared tolerance, at most, in a search
_ROUNDING = 1e-2  # tolerated violation of the constraints in sum, such as of the log risk
_MORE = 0.05  # margin with which a restoration satisfies the constraints
_SMALL = 1e-2  # factor on the penalised cost, which keeps the first step short
_RESTORE = 60  # iterations of a restoration
_CLOSE = 1e-5  # tolerance of the cost in the search
_STRIDE = 1.0  # robot radii that a place near an obstacle may move between two moments
_NEAR = 5.0  # standard deviations of clearance beyond which hits are neglected
_HALVINGS = 4  # of the time between two corrections, at most


@dataclass
class Search:
    """Search for the motion of least cost whose risk bound is below `allowed`.

    Sequential quadratic programming: the actuators' limits are linear constraints, the risk and
    the distances from the targets are nonlinear ones. Source: Kraft 1988, SLSQP of scipy.

    Attributes:
        problem: The problem.
        allowed: Upper limit of the risk bound.
        last: The last evaluation, which is reused for the same motion.
    """

    problem: MotionProblem
    allowed: float
    last: Evaluation | None = None
    _sloped: tuple[Evaluation, tuple[Array, Array]] | None = field(default=None, init=False)

    def merit(self, at: Evaluation) -> float:
        """Cost plus penalised violation of the constraints."""
        over = max(0.0, self.problem.log_risk(at) - float(np.log(self.allowed)))
        far = np.maximum(np.sqrt(self.problem.misses(at)) - 1.0, 0.0)
        return at.cost + _FAR * (over + float(far.sum()))

    def value(self, control: Array) -> float:
        """Merit of a motion; infinite if the robot has no equilibrium."""
        try:
            return self.merit(self.at(control))
        except NoShapeError:
            return np.inf

    def at(self, control: Array) -> Evaluation:
        """Evaluation of a motion with control points (C, S+2); cached for the last one."""
        if self.last is None or not np.array_equal(control, self.last.control):
            self.last = self.problem.evaluate(control, self.last)
        return self.last

    def improve(self, control: Array, iterations: int, *, restores: bool = True) -> Evaluation:
        """Search from a motion; `restores` allows a restoration phase if constraints are violated.

        It helps in narrow passages, where the constraints are strongly nonlinear.
        """
        best = self._minimize(control, iterations)
        if restores and self.missed(best):
            restored = self._minimize(best.control, _RESTORE, penalty=True)
            best = min(self._minimize(restored.control, iterations), best, key=self.merit)
        return best

    def missed(self, at: Evaluation) -> bool:
        """Whether a motion misses a target or exceeds the allowed risk."""
        return self.merit(at) > at.cost + _FAR * _ROUNDING

    def _margins(self, at: Evaluation) -> Array:
        """Margins (G+1,) of the targets and of the log risk; negative where violated."""
        risk = float(np.log(self.allowed)) - self.problem.log_risk(at)
        return np.append(_WITHIN - self.problem.misses(at), risk)

    def _margin_jacobian(self, at: Evaluation) -> Array:
        """Jacobian (G+1, n) of the margins by the free variables."""
        return -np.vstack([self.problem.misses_gradient(at), self._gradients(at)[1]])

    def _gradients(self, at: Evaluation) -> tuple[Array, Array]:
        """Gradients (n,) of cost and log risk by the free variables; cached for the last motion."""
        if self._sloped is None or self._sloped[0] is not at:
            self._sloped = at, self.problem.gradients(at)
        return self._sloped[1]

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Rows (m, n) and ends (m,) of the actuators' linear limits, rows x ≤ ends."""
        rows, centre, width = self.problem.space.polytope
        ends = np.concatenate([width + centre, width - centre])
        return np.concatenate([rows, -rows]), ends

    def _motion(self, free: Array) -> Evaluation:
        """Motion of free variables, projected onto the limits if these are exceeded."""
        edges, ends = self._limits
        new = self.problem.space.control(free)
        return self.at(
            self.problem.space.follow(new) if np.any(edges @ free > ends + 1e-9) else new
        )

    def _penalty(self, at: Evaluation) -> float:
        """Cost plus violation of the constraints with a margin, scaled to keep steps short."""
        short = np.maximum(_MORE - self._margins(at), 0.0)
        return _SMALL * (at.cost + _FAR * float(short.sum()))

    def _penalty_gradient(self, at: Evaluation) -> Array:
        short = self._margins(at) < _MORE
        slope = self._gradients(at)[0]
        return _SMALL * (slope - _FAR * short @ self._margin_jacobian(at))

    def _minimize(self, control: Array, iterations: int, *, penalty: bool = False) -> Evaluation:
        """Minimise from a motion by SLSQP; returns the given motion if the result is not better.

        Targets and risk are constraints, or terms of the cost with `penalty`.
        """
        edges, ends = self._limits

        def at(free: Array) -> Evaluation:
            return self.at(self.problem.space.control(free))

        limits = {"type": "ineq", "fun": lambda x: ends - edges @ x, "jac": lambda x: -edges}
        margins = {"type": "ineq", "fun": lambda x: self._margins(at(x)),
                "jac": lambda x: self._margin_jacobian(at(x))}  # fmt: skip
        value = self._penalty if penalty else lambda e: e.cost
        slope = self._penalty_gradient if penalty else lambda e: self._gradients(e)[0]
        begin = self.at(control)
        low, high = self.problem.space.bounds
        first = np.clip(self.problem.space.free(control), low, high)
        try:
            solution = minimize(
                lambda x: value(at(x)), first, method="SLSQP", jac=lambda x: slope(at(x)),
                bounds=np.stack([low, high], axis=-1),
                constraints=[limits] if penalty else [limits, margins],
                options={"maxiter": iterations, "ftol": _CLOSE * (_SMALL if penalty else 1.0)},
            )  # fmt: skip
        except NoShapeError:  # a trial step left the shapes with an equilibrium
            return begin
        return min((self._motion(solution.x), begin), key=self.merit)


def judged_closely(search: Search, motion: Evaluation) -> tuple[Search, Evaluation]:
    """Search with the additional moments that a motion needs, and the motion evaluated at these."""
    for _ in range(_HALVINGS):
        problem = search.problem
        parts, moments = _parts(problem, motion), problem.space.moments
        split = np.flatnonzero(parts > 1)
        if not split.size:
            break
        times = [np.linspace(moments[k], moments[k + 1], int(parts[k]) + 1)[1:-1] for k in split]
        space = problem.space.with_moments(np.concatenate(times))
        search = replace(search, problem=replace(problem, space=space), last=None)
        motion = search.at(motion.control)
    return search, motion


def _parts(problem: MotionProblem, motion: Evaluation) -> Index:
    """Number of parts (K−1,), a power of two, into which the time to the next moment is split."""
    space, clearances = problem.space, motion.clearances
    way = np.linalg.norm(np.diff(motion.shapes.place, axis=0), axis=-1)
    least = _over_neighbours(clearances.mean, np.minimum) - way
    near = np.any(least < _NEAR * _over_neighbours(clearances.std(), np.maximum), axis=0)
    longest = np.max(way, axis=1, where=near, initial=0.0)
    strides = longest / (_STRIDE * problem.scene.robot_radius)
    most = np.diff(space.moments) * 2**_HALVINGS / space.correction
    halvings = np.ceil(np.log2(np.clip(strides, 1.0, None)))
    out: Index = (2.0 ** np.minimum(halvings, np.round(np.log2(most)))).astype(np.intp)
    return out


def _over_neighbours(values: Array, which: np.ufunc) -> Array:
    """Minimum or maximum (O, K−1, N), by `which`, of values (O, K, N) at neighbouring moments."""
    out: Array = which(values[:, 1:], values[:, :-1])
    return out
