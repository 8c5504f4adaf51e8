"""The search for a motion of least cost at a bounded risk, from one that is given.

A motion is judged when commands are corrected, and in between where a place that comes near an
obstacle would otherwise go too far from one moment to the next, so that nothing passes unseen.
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

_FAR = 10.0  # of the cost, a constraint missed by its own size
_WITHIN = 0.99  # of what the tip may miss a target by, squared, that a plan aims at
_ROUNDING = 1e-2  # by which constraints, of the logarithm of the risk, may be missed
_MORE = 0.05  # by which a restored motion keeps constraints
_SMALL = 1e-2  # factor of a penalty, so that the first step is no longer than it may be
_RESTORE = 60  # iterations of a restoration
_CLOSE = 1e-5  # of the cost, that an iteration must gain
_STRIDE = 1.0  # robot radii that a place near something may go between two moments
_NEAR = 5.0  # standard deviations of clearance beyond which nothing is hit
_HALVINGS = 4  # of the time between two corrections at most


@dataclass
class Search:
    """A search for the motion of least cost whose bound of the risk is below `allowed`.

    Sequential quadratic programming: the limits of the actuators are linear, the risk and the
    distances from the targets are constraints. Source: Kraft 1988, as scipy has it.

    Attributes:
        problem: The problem.
        allowed: What the bound of the risk is held below.
        last: What was evaluated last.
    """

    problem: MotionProblem
    allowed: float
    last: Evaluation | None = None
    _sloped: tuple[Evaluation, tuple[Array, Array]] | None = field(default=None, init=False)

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

    def improve(self, control: Array, iterations: int, *, restores: bool = True) -> Evaluation:
        """The best motion that the search leads to; `restores` takes longer where it misses.

        Narrow passages bend the constraints more than their slopes say.
        """
        best = self._minimize(control, iterations)
        if restores and self.missed(best):
            restored = self._minimize(best.control, _RESTORE, penalty=True)
            best = min(self._minimize(restored.control, iterations), best, key=self.merit)
        return best

    def missed(self, at: Evaluation) -> bool:
        """Whether a motion misses a target, or risks more than is allowed."""
        return self.merit(at) > at.cost + _FAR * _ROUNDING

    def _gaps(self, at: Evaluation) -> Array:
        """What is left of what targets (G,) and, last, the risk may be; negative where missed."""
        risk = float(np.log(self.allowed)) - self.problem.log_risk(at)
        return np.append(_WITHIN - self.problem.misses(at), risk)

    def _gap_slopes(self, at: Evaluation) -> Array:
        """Slopes (G+1, n) of that by the free numbers."""
        return -np.vstack([self.problem.misses_gradient(at), self._gradients(at)[1]])

    def _gradients(self, at: Evaluation) -> tuple[Array, Array]:
        """Slopes (n,) of the cost and the logarithm of the risk by the free numbers."""
        if self._sloped is None or self._sloped[0] is not at:
            self._sloped = at, self.problem.gradients(at)
        return self._sloped[1]

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Rows (m, n) and ends (m,) of the limits of speeds and accelerations, rows x ≤ ends."""
        rows, centre, width = self.problem.space.polytope
        ends = np.concatenate([width + centre, width - centre])
        return np.concatenate([rows, -rows]), ends

    def _motion(self, free: Array) -> Evaluation:
        """The motion of free numbers that keep the limits but for rounding."""
        edges, ends = self._limits
        new = self.problem.space.control(free)
        return self.at(
            self.problem.space.follow(new) if np.any(edges @ free > ends + 1e-9) else new
        )

    def _penalty(self, at: Evaluation) -> float:
        """Cost and what is missed, so small that a first step is no longer than it may be."""
        short = np.maximum(_MORE - self._gaps(at), 0.0)
        return _SMALL * (at.cost + _FAR * float(short.sum()))

    def _penalty_gradient(self, at: Evaluation) -> Array:
        short = self._gaps(at) < _MORE
        slope = self._gradients(at)[0]
        return _SMALL * (slope - _FAR * short @ self._gap_slopes(at))

    def _minimize(self, control: Array, iterations: int, *, penalty: bool = False) -> Evaluation:
        """What the programs lead to from a motion; the motion itself where that is no better.

        What may be missed is a constraint, or a `penalty`.
        """
        edges, ends = self._limits

        def at(free: Array) -> Evaluation:
            return self.at(self.problem.space.control(free))

        limits = {"type": "ineq", "fun": lambda x: ends - edges @ x, "jac": lambda x: -edges}
        gaps = {"type": "ineq", "fun": lambda x: self._gaps(at(x)),
                "jac": lambda x: self._gap_slopes(at(x))}  # fmt: skip
        value = self._penalty if penalty else lambda e: e.cost
        slope = self._penalty_gradient if penalty else lambda e: self._gradients(e)[0]
        begin = self.at(control)
        low, high = self.problem.space.bounds
        first = np.clip(self.problem.space.free(control), low, high)
        try:
            solution = minimize(
                lambda x: value(at(x)), first, method="SLSQP", jac=lambda x: slope(at(x)),
                bounds=np.stack([low, high], axis=-1),
                constraints=[limits] if penalty else [limits, gaps],
                options={"maxiter": iterations, "ftol": _CLOSE * (_SMALL if penalty else 1.0)},
            )  # fmt: skip
        except NoShapeError:  # a trial step bent the robot beyond what has a shape
            return begin
        return min((self._motion(solution.x), begin), key=self.merit)


def judged_closely(search: Search, motion: Evaluation) -> tuple[Search, Evaluation]:
    """The search with all moments that a motion needs, and the motion judged at these."""
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
    """How many parts (K−1,) the time to the next moment needs, each twice as many as another."""
    space, clearances = problem.space, motion.clearances
    way = np.linalg.norm(np.diff(motion.shapes.place, axis=0), axis=-1)
    least = _both(clearances.mean, np.minimum) - way
    near = np.any(least < _NEAR * _both(clearances.std(), np.maximum), axis=0)
    longest = np.max(way, axis=1, where=near, initial=0.0)
    strides = longest / (_STRIDE * problem.scene.robot_radius)
    most = np.diff(space.moments) * 2**_HALVINGS / space.correction
    halvings = np.ceil(np.log2(np.clip(strides, 1.0, None)))
    out: Index = (2.0 ** np.minimum(halvings, np.round(np.log2(most)))).astype(np.intp)
    return out


def _both(values: Array, which: np.ufunc) -> Array:
    """Of values (O, K, N), those (O, K−1, N) of a moment or the next."""
    out: Array = which(values[:, 1:], values[:, :-1])
    return out
