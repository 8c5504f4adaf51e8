"""Estimate of the robot's shape from motion capture alone, with the joint covariance of errors."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from glissando.calibration.rig.rig import RigData
from glissando.errors import RecordingError
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

_FINE, _MARGIN = 0.03, 1e-3  # m: node spacing where the coil slides; tolerance of that range
_APART = 5e-4  # m: an arclength nearer than this to an end or a joint uses its node
_RATE, _MOST = 16.0, 1000  # Hz: lowest rate of time nodes; their largest number
_SPARSE = 2  # stride of the time nodes that are used while the robot is still
_STILL = 3.0  # RMS motion, in standard deviations of the noise, below which a body is still
_ANYWHERE = 1.0  # m² and rad²: variance of a base that is located by bodies
_LAPSE, _MOVED = 0.3, 4.0  # s before and after a time that are compared; standard deviations
_STILL_PACE = 1e-3  # factor of the densities along time while the robot is still


def body_readings(data: RigData) -> list[PoseReadings]:
    """Pose readings of every motion capture body."""
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


def estimate_shape(data: RigData, robot: Robot) -> Posterior:
    """Estimate shape and motion from motion capture alone.

    A robot at rest is estimated at a single time: a motion fitted to noise would make delays of the
    clocks appear observable.

    Args:
        data: The session.
        robot: The robot with its prior.

    Raises:
        RecordingError: If all samples of the bodies are of a single time.
    """
    readings = body_readings(data)
    start, stop = span(data)
    if not stop > start:
        raise RecordingError(
            f"Motion capture saw {', '.join(data.bodies)} at a single time; record it for as long "
            f"as the tracker."
        )
    rate = max(robot.time_rate, min(_RATE, _MOST / (stop - start)))
    grid = replace(robot, arclength_nodes=_nodes(data, robot), time_rate=rate).grid(start, stop)
    prior = _free_base(robot, data)
    if _keeps_still(data):
        middle = np.array([0.5 * (start + stop)])
        grid = Grid(grid.arclength, middle)
        readings = [r.changed(time=np.repeat(middle, len(r))) for r in readings]
    elif isinstance(prior, WhiteNoisePrior):
        prior, grid = _with_pace(prior, data, grid)
    return estimate(prior, grid, readings)


def _with_pace(prior: WhiteNoisePrior, data: RigData, grid: Grid) -> tuple[WhiteNoisePrior, Grid]:
    """Prior with smaller densities and grid with fewer time nodes while the robot is still."""
    moves = _moves(data, 0.5 * (grid.time[1:] + grid.time[:-1]))
    used = np.arange(grid.time.size) % _SPARSE == 0
    used[:-1] |= moves
    used[1:] |= moves
    used[-1] = True
    time = grid.time[used]
    pace = np.where(moves[np.flatnonzero(used)[:-1]], 1.0, _STILL_PACE)
    return replace(prior, pace=pace, pace_times=time[1:-1]), Grid(grid.arclength, time)


def _moves(data: RigData, time: Array) -> NDArray[np.bool_]:
    """Whether any body moves at each time (K,) by more than the noise of motion capture."""
    std, moves = np.repeat(data.noise.mocap, 3), np.zeros(time.size, dtype=bool)
    for body in data.bodies.values():
        at = np.searchsorted(body.time, [time - _LAPSE, time, time + _LAPSE])
        for k, (first, now, last) in enumerate(at.T):
            count = min(now - first, last - now)
            if count:
                step = se3.log(se3.inverse(body.poses[now]) @ body.poses[first:last])
                displacement = step[now - first :].mean(axis=0) - step[: now - first].mean(axis=0)
                step_std = std * np.sqrt(1.0 / (now - first) + 1.0 / (last - now))
                moves[k] |= bool(np.any(np.abs(displacement) > _MOVED * step_std))
    return moves


def span(data: RigData) -> tuple[float, float]:
    """First and last time of motion capture's samples, s."""
    times = [b.time for b in data.bodies.values()]
    return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def _keeps_still(data: RigData) -> bool:
    """Whether all bodies are still, to within `_STILL` times the noise of motion capture."""
    std = np.repeat(data.noise.mocap, 3)
    for body in data.bodies.values():
        moved = se3.log(se3.inverse(body.poses[len(body.poses) // 2]) @ body.poses) / std
        if np.sqrt(np.mean(np.var(moved, axis=0))) > _STILL:
            return False
    return True


def _nodes(data: RigData, robot: Robot) -> Array:
    """Arclength nodes (N,) at every joint and body, closely spaced where the coil slides.

    The interpolation covariance is treated as independent for each reading, so it must be small.
    """
    travel = np.append(data.travel, 0.0)
    reach = np.concatenate([data.coil_arclength + travel, data.coil_arclength - travel])
    low, high = np.clip([reach.min(), reach.max()], 0.0, robot.length)
    exact = np.unique([0.0, robot.length, *robot.prior.joints])
    places = np.array([low, high, *(body.arclength for body in data.bodies.values())])
    separate = np.min(np.abs(places[:, None] - exact), axis=1) > _APART
    ends = np.unique([*exact, *np.round(places[separate], 3)])
    widest = float(np.diff(robot.arclength_nodes).max())
    out = [ends[:1]]
    for first, last in pairwise(ends):
        reached = last > low + _MARGIN and first < high - _MARGIN
        step = min(_FINE, widest) if reached else widest
        out.append(np.linspace(first, last, int(np.ceil((last - first) / step - 1e-9)) + 1)[1:])
    return np.concatenate(out)


def _free_base(robot: Robot, data: RigData) -> Prior:
    """Prior with a free base, initialised from the bodies, if there are two or more.

    The base pose in motion capture's world is seldom as accurate as a robot file states.
    """
    prior = robot.prior
    if len(data.bodies) < 2 or not isinstance(prior, WhiteNoisePrior | SeparablePrior):
        return prior
    if prior.base is None:
        return prior
    body = min(data.bodies.values(), key=lambda b: b.arclength)
    nodes = robot.grid(0.0, 1.0)
    rest = prior.rest_state(nodes).pose[0]
    near = int(np.argmin(np.abs(nodes.arclength - body.arclength)))
    T_sb = se3.inverse(prior.base_pose) @ rest[near]
    base_pose = body.poses[0] @ se3.inverse(body.mount) @ se3.inverse(T_sb)
    anywhere = np.full(6, _ANYWHERE)
    if isinstance(prior, SeparablePrior):
        return replace(prior, base_pose=base_pose, base=replace(prior.base, pose=anywhere))
    return replace(prior, base_pose=base_pose, base=replace(prior.base, pose=anywhere))


def shape_covariance(
    shape: Posterior,
    chol: Cholesky,
    arclength: Array,
    time: Array,
    by_state: Array,
    along: Array | None = None,
) -> Array:
    """Joint covariance of linear functions of the shape's states at many points.

    Time nodes are correlated by a chain of gains, Cov(k, j) = A_k Cov(k+1, j), which is evaluated
    once from the last time node to the first. The covariance of interpolation between nodes (13) is
    added for each point.

    Args:
        shape: Posterior of the shape.
        chol: Cholesky factor of the posterior's information.
        arclength: Arclengths (M,), m.
        time: Non-decreasing times (M,), s.
        by_state: Jacobians (M, r, 18) of the functions with respect to the states.
        along: Further Jacobians (M, r, N·dof) with respect to all nodes at each point's time.

    Returns:
        Covariance (M·r, M·r).
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
        slope = by_state[points.rows]
        own[points.rows] = slope @ at.cov @ np.swapaxes(slope, -1, -2)
    if along is not None:
        share = np.clip(np.interp(time, shape.grid.time, np.arange(last + 1)) - lower, 0.0, 1.0)
        touched += np.stack([1.0 - share, share])[..., None, None] * along
    return _chained_covariance(shape, chol, lower, touched) + np.asarray(block_diag(*own))


def _chained_covariance(shape: Posterior, chol: Cholesky, lower: Array, touched: Array) -> Array:
    """Joint covariance (M·r, M·r) of linear functions of two neighbouring time nodes each.

    Rows `touched` (2, M, r, D) apply to the time nodes `lower` (M,) and the next.
    """
    _, m, r, width = touched.shape
    cov, cross = shape.marginals.cov, shape.marginals.cross
    out = np.zeros((m * r, m * r))
    done = m  # `ahead` is the covariance of the next time node with the readings from here on
    ahead = np.zeros((width, 0))
    for k in reversed(range(len(cov))):
        of_slab = np.flatnonzero(lower == k)
        first = int(of_slab[0]) if of_slab.size else done
        own_rows, next_rows = (part[first:done].reshape(-1, width) for part in touched)
        if k < len(cross):
            later = -chol.inverse[k].T @ (chol.coupling[k] @ ahead)
            with_next = cross[k] @ next_rows.T
            own = cov[k + 1] @ next_rows.T + cross[k].T @ own_rows.T
            block = next_rows @ own + own_rows @ (cov[k] @ own_rows.T + with_next)
        else:
            later, with_next = ahead, 0.0
            block = own_rows @ cov[k] @ own_rows.T
        rows, rest = slice(first * r, done * r), slice(done * r, m * r)
        out[rows, rows] = block
        out[rows, rest] = own_rows @ later + next_rows @ ahead
        out[rest, rows] = out[rows, rest].T
        ahead = np.hstack([cov[k] @ own_rows.T + with_next, later])
        done = first
    return out
