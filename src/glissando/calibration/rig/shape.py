"""The robot's shape as motion capture alone shows it, and how its errors go together."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from glissando.calibration.rig.rig import RigData
from glissando.estimation.batch import estimate
from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior
from glissando.model.priors.separable import SeparablePrior
from glissando.model.priors.white_noise import WhiteNoisePrior
from glissando.model.robot import Robot
from glissando.model.sensors.sensors import PoseReadings
from glissando.solver.block_tridiagonal import Cholesky

_FINE, _MARGIN = 0.03, 1e-3  # m: between nodes where the coil slides, and of its reach
_RATE, _MOST = 16.0, 1000  # Hz of nodes in time where the robot's are fewer, and at most so many
_SPARSE = 2  # of these one is kept while the robot holds
_MOVES = 3.0  # standard deviations of its noise by which a body that moves does so
_ANYWHERE = 1.0  # m² and rad²: a base that bodies place
_LAPSE, _SEEN = 0.3, 4.0  # s before and after which are compared, and standard deviations that tell
_HOLDS = 1e-3  # of the densities along time, what is left while the robot holds


def body_readings(data: RigData) -> list[PoseReadings]:
    """Every body's poses as readings."""
    var = np.repeat(np.asarray(data.noise.mocap) ** 2, 3)
    return [
        PoseReadings(
            time=b.time,
            arclength=np.full(b.time.size, b.arclength),
            values=b.poses,
            cov=var,
            mount=b.mount,
            name=name,
        )
        for name, b in data.bodies.items()
    ]


def shape_of(data: RigData, robot: Robot) -> Posterior:
    """The posterior of shape and motion given motion capture alone.

    A robot that keeps still has one shape at one time: a motion that is fitted to noise would be
    believed to tell the time.
    """
    readings = body_readings(data)
    start, stop = span(data)
    rate = max(robot.time_rate, min(_RATE, _MOST / (stop - start)))
    grid = replace(robot, arclength_nodes=_nodes(data, robot), time_rate=rate).grid(start, stop)
    prior = _loose(robot, data)
    if keeps_still(data):
        middle = np.array([0.5 * (start + stop)])
        grid = Grid(grid.arclength, middle)
        readings = [r.changed(time=np.repeat(middle, len(r))) for r in readings]
    elif isinstance(prior, WhiteNoisePrior):
        prior, grid = _paced(prior, data, grid)
    return estimate(prior, grid, readings)


def _paced(prior: WhiteNoisePrior, data: RigData, grid: Grid) -> tuple[WhiteNoisePrior, Grid]:
    """The prior with a pace and a grid for it: those of a robot that holds from time to time.

    Were it as restless at all times, what it does while it holds would be uncertain; and were its
    nodes as sparse while it moves, what it does between them.
    """
    moves = _moves(data, 0.5 * (grid.time[1:] + grid.time[:-1]))
    kept = np.arange(grid.time.size) % _SPARSE == 0
    kept[:-1] |= moves
    kept[1:] |= moves
    kept[-1] = True
    first = np.flatnonzero(kept)[:-1]
    time = grid.time[kept]
    pace = np.where(moves[first], 1.0, _HOLDS)
    return replace(prior, pace=pace, pace_times=time[1:-1]), Grid(grid.arclength, time)


def _moves(data: RigData, time: Array) -> NDArray[np.bool_]:
    """At which times (K,) a body is not where it was a moment before, by what its noise allows."""
    std, found = np.repeat(data.noise.mocap, 3), np.zeros(time.size, dtype=bool)
    for body in data.bodies.values():
        at = np.searchsorted(body.time, [time - _LAPSE, time, time + _LAPSE])
        for k, (first, now, last) in enumerate(at.T):
            count = min(now - first, last - now)
            if count:
                step = se3.log(se3.inverse(body.poses[now]) @ body.poses[first:last])
                way = step[now - first :].mean(axis=0) - step[: now - first].mean(axis=0)
                spread = std * np.sqrt(1.0 / (now - first) + 1.0 / (last - now))
                found[k] |= bool(np.any(np.abs(way) > _SEEN * spread))
    return found


def span(data: RigData) -> tuple[float, float]:
    """First and last time at which motion capture saw a body."""
    times = [b.time for b in data.bodies.values()]
    return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def keeps_still(data: RigData) -> bool:
    """Whether no body moves by much more than the noise of motion capture."""
    std = np.repeat(data.noise.mocap, 3)
    for body in data.bodies.values():
        moved = se3.log(se3.inverse(body.poses[len(body.poses) // 2]) @ body.poses) / std
        if np.sqrt(np.mean(np.var(moved, axis=0))) > _MOVES:
            return False
    return True


def _nodes(data: RigData, robot: Robot) -> Array:
    """Arclengths with a node at every body, and closely where the coil slides.

    What nodes cannot tell of a place between them would count as news with every reading there.
    """
    travel = np.append(data.travel, 0.0)
    reach = np.concatenate([data.coil_arclength + travel, data.coil_arclength - travel])
    low, high = np.clip([reach.min(), reach.max()], 0.0, robot.length)
    fixed = [0.0, robot.length, low, high, *robot.prior.joints]
    fixed += [body.arclength for body in data.bodies.values()]
    ends = np.unique(np.round(fixed, 3))
    widest = float(np.diff(robot.arclength_nodes).max())
    out = [ends[:1]]
    for first, last in pairwise(ends):
        slid = last > low + _MARGIN and first < high - _MARGIN
        step = min(_FINE, widest) if slid else widest
        out.append(np.linspace(first, last, int(np.ceil((last - first) / step - 1e-9)) + 1)[1:])
    return np.concatenate(out)


def _loose(robot: Robot, data: RigData) -> Prior:
    """The robot's prior with its base where the bodies put it, if there are two or more.

    Where the base stands in motion capture's world is seldom known to the fraction of a millimetre
    that a robot file claims.
    """
    prior = robot.prior
    if not isinstance(prior, WhiteNoisePrior | SeparablePrior):
        return prior
    if len(data.bodies) < 2 or prior.base is None:
        return prior
    body = min(data.bodies.values(), key=lambda b: b.arclength)
    nodes = robot.grid(0.0, 1.0)
    rest = prior.rest_state(nodes).pose[0]
    near = int(np.argmin(np.abs(nodes.arclength - body.arclength)))
    T_sb = se3.inverse(prior.base_pose) @ rest[near]
    base_pose = body.poses[0] @ se3.inverse(body.mount) @ se3.inverse(T_sb)
    anywhere = np.full(6, _ANYWHERE)
    # the same for both, but each base is of its own type
    if isinstance(prior, SeparablePrior):
        return replace(prior, base_pose=base_pose, base=replace(prior.base, pose=anywhere))
    return replace(prior, base_pose=base_pose, base=replace(prior.base, pose=anywhere))


def shape_covariance(
    shape: Posterior, chol: Cholesky, arclength: Array, time: Array, by_state: Array
) -> Array:
    """Joint covariance (M·r, M·r) of by_state (M, r, 18) times the states' errors at points (M,).

    Times must not decrease; `chol` is the factor of the shape's information. Slabs a long time
    apart go together by a chain of gains, Cov(k, j) = A_k Cov(k+1, j), which is run once from the
    last slab to the first. What nodes cannot tell is added point by point (13).
    """
    m, r, _ = by_state.shape
    width = shape.grid.arclength.size * shape.state.dof
    last = len(shape.marginals.cov) - 1
    touched, own = np.zeros((2, m, r, width)), np.zeros((m, r, r))
    lower = np.zeros(m, dtype=int)
    for points in sort_points(shape.grid, arclength, time):
        at = shape.prior.interpolate(shape.grid, shape.state, shape.state, points)
        slab, inner = np.divmod(at.nodes, shape.grid.arclength.size)
        slopes = np.einsum("mrd,mdcx->mcrx", by_state[points.rows], at.jacobian)
        lower[points.rows] = np.minimum(slab.min(axis=1), max(last - 1, 0))
        for c in range(at.nodes.shape[1]):
            for i, row in enumerate(points.rows):
                columns = slice(inner[i, c] * at.dof, (inner[i, c] + 1) * at.dof)
                touched[slab[i, c] - lower[row], row, :, columns] += slopes[i, c]
        mine = by_state[points.rows]
        own[points.rows] = mine @ at.cov @ np.swapaxes(mine, -1, -2)
    out = _chained(shape, chol, lower, touched)
    for i in range(m):
        out[i * r : (i + 1) * r, i * r : (i + 1) * r] += own[i]
    return out


def _chained(shape: Posterior, chol: Cholesky, lower: Array, touched: Array) -> Array:
    """Joint covariance (M·r, M·r) of rows (2, M, r, D) of slabs `lower` (M,) and the next."""
    _, m, r, width = touched.shape
    cov, cross = shape.marginals.cov, shape.marginals.cross
    out = np.zeros((m * r, m * r))
    done = m  # readings from here on are in `ahead`, the covariance of the next slab with them
    ahead = np.zeros((width, 0))
    for k in reversed(range(len(cov))):
        mine = np.flatnonzero(lower == k)
        first = int(mine[0]) if mine.size else done
        here, there = (part[first:done].reshape(-1, width) for part in touched)
        if k < len(cross):
            later = -chol.inverse[k].T @ (chol.coupling[k] @ ahead)
            with_next = cross[k] @ there.T
            own = cov[k + 1] @ there.T + cross[k].T @ here.T
            block = there @ own + here @ (cov[k] @ here.T + with_next)
        else:
            later, with_next = ahead, 0.0
            block = here @ cov[k] @ here.T
        rows, rest = slice(first * r, done * r), slice(done * r, m * r)
        out[rows, rows] = block
        out[rows, rest] = here @ later + there @ ahead
        out[rest, rows] = out[rows, rest].T
        ahead = np.hstack([cov[k] @ here.T + with_next, later])
        done = first
    return out
