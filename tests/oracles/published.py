"""The published kinematic space-time estimator, slow and obvious; no code shared with the package.

Equations (3), (4), (5), (10) of docs/math.md. Comparison with the golden posterior settled:
* residual rows are plain, without J_r^-1; Q_s follows the velocity at every iteration but is NOT
  differentiated, so the answer lies near, not at, the minimum of the equivalent cost (3');
* P0 acts on the base node of every time; a tracker's repeated rows count again; no robust loss;
* time nodes share evenly the span from the start to the LAST READING of the window (28.983 s);
  readings between them are predicted by (10) with J_r^-1, and R is not widened;
* queries go along s at both times, then along t; (10) along s has W in Q_s, not in the transition.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

Array = np.ndarray
Stream = tuple[str, Array, Array, Array]  # type, time, arclength, values
DOF, STEP, REST_STRAIN = 18, 1e-5, np.eye(6)[2]  # STEP: of the central differences
apply = partial(np.einsum, "nij,nj->ni")  # matrices times vectors


@dataclass(frozen=True)
class Settings:
    """Published values of the real robot; a pair is (translation, rotation), p0 a whole node."""

    factor: float = 0.15  # on every Q and P0, on no R
    q1: tuple[float, float] = (30.0, 8e3)
    q2: tuple[float, float] = (0.8, 1e3)
    q3: tuple[float, float] = (0.8, 1e4)
    p0: tuple[float, ...] = (*[8e-5] * 3, *[1e-3] * 3, *[1e-2] * 3, 1e3, 1e3, 1e-4, *[100.0] * 6)
    r_pose: tuple[float, float] = (2e-5, 2.5e-3)
    r_gyro: float = 1e-6


class State(NamedTuple):
    """A batch of nodes: pose (n, 4, 4), strain (n, 6), velocity (n, 6)."""

    pose: Array
    strain: Array
    velocity: Array

    def moved(self, d: Array) -> "State":
        """Perturb by 18-vectors, the pose on the right."""
        return State(self[0] @ se3_exp(d[:, :6]), self[1] + d[:, 6:12], self[2] + d[:, 12:])


def hat(x: Array) -> Array:
    """Cross-product matrices (n, 3, 3) of vectors."""
    out = np.zeros((len(x), 3, 3))
    out[:, [2, 0, 1], [1, 2, 0]] = x
    out[:, [1, 2, 0], [2, 0, 1]] = -x
    return out


def ad(x: Array) -> Array:
    """Lie bracket matrices of [linear, angular] vectors."""
    out = np.zeros((len(x), 6, 6))
    out[:, :3, 3:] = hat(x[:, :3])
    out[:, :3, :3] = out[:, 3:, 3:] = hat(x[:, 3:])
    return out


def v_matrix(phi: Array) -> Array:
    """The V of p = V rho; its two coefficients are constant to 1e-7 below 1 mrad."""
    a = np.maximum(np.linalg.norm(phi, axis=1), 1e-3)[:, None, None]
    k = hat(phi)
    return np.eye(3) + (1 - np.cos(a)) / a**2 * k + (a - np.sin(a)) / a**3 * k @ k


def se3_exp(x: Array) -> Array:
    """Poses (n, 4, 4) from [rho, phi]."""
    out = np.tile(np.eye(4), (len(x), 1, 1))
    out[:, :3, :3] = Rotation.from_rotvec(x[:, 3:]).as_matrix()
    out[:, :3, 3] = apply(v_matrix(x[:, 3:]), x[:, :3])
    return out


def between(a: Array, b: Array) -> Array:
    """log(a^-1 b) of batches of poses."""
    back = a[..., :3, :3].swapaxes(-1, -2)
    phi = Rotation.from_matrix(back @ b[:, :3, :3]).as_rotvec()
    shift = back @ (b - a)[:, :3, 3:]
    return np.hstack([np.linalg.solve(v_matrix(phi), shift)[..., 0], phi])


def right_jacobian_inverse(x: Array) -> Array:
    """J_r^-1 by its Bernoulli series: steps between nodes stay far below 2 pi."""
    return np.eye(6) + (a := ad(x)) / 2 + a @ a / 12 - a @ a @ a @ a / 720


def derivatives(error: Callable[..., Array], states: list[State]) -> Array:
    """Central differences of a batched error, (n, rows, 18 for each state)."""
    out = []
    for j, state in enumerate(states):
        for d in STEP * np.eye(DOF)[:, None]:
            ahead, behind = (error(*states[:j], state.moved(e), *states[j + 1 :]) for e in (d, -d))
            out.append((ahead - behind) / (2 * STEP))
    return np.stack(out, -1)


class Axis:
    """A direction of the grid: the factor between neighbours h apart, and what lies between."""

    def __init__(self, along_s: bool, h: float, settings: Settings) -> None:
        self.along_s, self.h = along_s, h
        self.shift = np.kron([[0, along_s, not along_s], [0] * 3, [0] * 3], np.eye(6))
        white = (*settings.q2, *settings.q3) if along_s else (*settings.q3, *settings.q1)
        self.noise = settings.factor * np.diag(np.repeat([0.0, 0.0, *white], 3))

    def error(self, a: State, b: State, h: Array | float) -> Array:
        """The error of (3) or (4)."""
        flow = np.atleast_1d(h)[:, None] * (a.strain if self.along_s else a.velocity)
        change = b.velocity - a.velocity + self.along_s * apply(ad(flow), a.velocity)
        return np.hstack([between(a.pose, b.pose) - flow, b.strain - a.strain, change])

    def covariance(self, a: State | None, h: Array | float) -> Array:
        """Noise through I + h shift: Q_t of (4), or Q_s of (3), where W copies row 1 to row 3."""
        h, s, c = np.atleast_1d(h)[:, None, None], self.shift, self.noise
        q = h * c + h**2 / 2 * (s @ c + c @ s.T) + h**3 / 3 * s @ c @ s.T
        if not self.along_s:
            return q
        copy = np.eye(DOF) + np.pad(ad(a.velocity), ((0, 0), (12, 0), (0, 12)))
        return copy @ q @ copy.swapaxes(1, 2)

    def gain(self, a: State | None, u: Array) -> Array:
        """The Psi of (10), which along t does not depend on the state."""
        onward = np.eye(DOF) + (self.h - u)[:, None, None] * self.shift.T
        return self.covariance(a, u) @ onward @ np.linalg.inv(self.covariance(a, self.h))

    def interpolate(self, a: State, b: State, u: Array, psi: Array | None = None) -> State:
        """(10): g(u) = Phi(u) g_0 + Psi (g_1 - Phi(h) g_0)."""
        psi = self.gain(a, u) if psi is None else psi
        to = right_jacobian_inverse(xi := between(a.pose, b.pose))
        g0 = np.hstack([0 * xi, a.strain, a.velocity])
        g1 = np.hstack([xi, apply(to, b.strain), apply(to, b.velocity)])
        rate = g0 @ self.shift.T
        g = g0 + u[:, None] * rate + apply(psi, g1 - g0 - self.h * rate)
        back = np.linalg.inv(right_jacobian_inverse(g[:, :6]))
        return State(a.pose @ se3_exp(g[:, :6]), apply(back, g[:, 6:12]), apply(back, g[:, 12:]))

    def insertion(self, a: State, m: State, b: State, u: Array) -> tuple[Array, Array]:
        """Golden covariances: gain on [a, b] and own part of an unmeasured node m between them."""
        u = np.clip(u, 1e-6 * self.h, self.h * (1 - 1e-6))
        f1, e1 = np.split(derivatives(partial(self.error, h=u), [a, m])[0], 2, 1)
        e2, f2 = np.split(derivatives(partial(self.error, h=self.h - u), [m, b])[0], 2, 1)
        pull1 = e1.T @ np.linalg.inv(self.covariance(a, u)[0])
        pull2 = e2.T @ np.linalg.inv(self.covariance(m, self.h - u)[0])
        own = np.linalg.inv(pull1 @ e1 + pull2 @ e2)
        return -own @ np.hstack([pull1 @ f1, pull2 @ f2]), own


class Solution(NamedTuple):
    """Nodes in time-major order, and the factorised normal equations at the last iterate."""

    s: Array
    t: Array
    nodes: State
    normal: SuperLU
    axes: list[Axis]

    def walk(self, s: Array | float, t: Array | float) -> tuple:
        """Node numbers and states 00, 10, 01, 11; states at early, late and t; both offsets."""
        s, t = np.broadcast_arrays(np.atleast_1d(s), np.atleast_1d(t))
        i = np.clip(np.searchsorted(self.s, s + 1e-9) - 1, 0, len(self.s) - 2)
        k = np.clip(np.searchsorted(self.t, t + 1e-9) - 1, 0, len(self.t) - 2)
        ids = k * len(self.s) + i + np.array([[0], [1], [len(self.s)], [len(self.s) + 1]])
        corners = [State(*(part[j] for part in self.nodes)) for j in ids]
        ds, dt = s - self.s[i], t - self.t[k]
        ends = [self.axes[0].interpolate(*corners[j : j + 2], ds) for j in (0, 2)]
        return ids, corners, (*ends, self.axes[1].interpolate(*ends, dt)), ds, dt

    def pose_at(self, s: Array | float, t: Array | float) -> Array:
        """T_wb, (n, 4, 4)."""
        return self.walk(s, t)[2][2].pose

    def pose_covariance_at(self, s: float, t: float) -> Array:
        """6 x 6, of a right perturbation in the body frame."""
        ids, (a, b, c, d), (early, late, here), ds, dt = self.walk(s, t)
        columns = (DOF * ids + np.arange(DOF)).ravel()
        unit = sp.eye(DOF * len(self.nodes.pose), format="csc")[:, columns].toarray()
        inner = [self.axes[0].insertion(*x, ds) for x in ((a, early, b), (c, late, d))]
        gain, own = (sp.block_diag(parts).toarray() for parts in zip(*inner, strict=True))
        joint = gain @ self.normal.solve(unit)[columns] @ gain.T + own
        gain, own = self.axes[1].insertion(early, here, late, dt)
        return (gain @ joint @ gain.T + own)[:6, :6]


def read_stream(path: Path) -> Stream:
    """One file of the recording: type, time, arclength, values."""
    time, place, *values = np.loadtxt(path, delimiter=",", skiprows=2, unpack=True)
    return path.read_text().splitlines()[0].split(",")[1], time, place, np.transpose(values)


def published_times(streams: list[Stream], start: float, stop: float, count: int) -> Array:
    """The time nodes of a window; the published count is one more than 30 Hz times its length."""
    return np.linspace(start, max(x[1][x[1] <= stop].max() for x in streams), count)


def factors_of(streams: list[Stream], s: Array, t: Array, axes: list[Axis], c: Settings) -> list:
    """(5), (3), (4), readings at arclength nodes; each is node numbers, error, covariance."""

    def base(a: State) -> Array:
        return np.hstack([between(np.eye(4), a.pose), a.strain - REST_STRAIN, a.velocity])

    def reading(measured: Array, gyro: bool, u: Array, psi: Array, a: State, b: State) -> Array:
        at = axes[1].interpolate(a, b, u, psi)
        return at.velocity[:, 3:] - measured if gyro else between(se3_exp(measured), at.pose)

    ids = np.arange(len(t) * len(s)).reshape(len(t), len(s))
    out = [([ids[:, 0]], base, lambda _: c.factor * np.diag(c.p0))]
    for x, a, b in ((axes[0], ids[:, :-1], ids[:, 1:]), (axes[1], ids[:-1], ids[1:])):
        out.append(([a.ravel(), b.ravel()], partial(x.error, h=x.h), partial(x.covariance, h=x.h)))
    for kind, time, place, values in streams:
        keep, gyro = (time >= t[0]) & (time <= t[-1]), kind == "gyro"
        k = np.clip(np.searchsorted(t, time[keep], "right") - 1, 0, len(t) - 2)
        i = ids[k, np.flatnonzero(np.isclose(s, place[0]))[0]]
        r = np.diag(np.repeat(c.r_gyro if gyro else c.r_pose, 3))
        u = time[keep] - t[k]
        error = partial(reading, values[keep], gyro, u, axes[1].gain(None, u))
        out.append(([i, i + len(s)], error, lambda _, r=r: r))
    return out


def solve_published(
    streams: list[Stream], grid_arclength: Array, grid_time: Array, settings: Settings
) -> Solution:
    """Gauss-Newton from a straight rod at rest."""
    s, t, count = grid_arclength, grid_time, len(grid_arclength) * len(grid_time)
    axes = [Axis(True, s[1] - s[0], settings), Axis(False, t[1] - t[0], settings)]
    rest = np.tile(REST_STRAIN, (count, 1))
    nodes = State(se3_exp(rest * np.tile(s, len(t))[:, None]), rest, 0 * rest)
    for _ in range(100):
        gradient, parts = np.zeros(DOF * count), []
        for ids, error, covariance in factors_of(streams, s, t, axes, settings):
            states = [State(*(part[i] for part in nodes)) for i in ids]
            slope = derivatives(error, states)
            pull = slope.swapaxes(1, 2) @ np.linalg.inv(covariance(states[0]))
            columns = np.hstack([DOF * i[:, None] + np.arange(DOF) for i in ids])
            np.add.at(gradient, columns, apply(pull, error(*states)))
            rows = np.broadcast_to(columns[..., None], (*columns.shape, columns.shape[1]))
            parts.append([x.ravel() for x in (pull @ slope, rows, rows.swapaxes(1, 2))])
        value, row, column = (np.concatenate(x) for x in zip(*parts, strict=True))
        normal = splu(sp.csc_matrix((value, (row, column))), "NATURAL")
        nodes = nodes.moved(step := -normal.solve(gradient).reshape(count, DOF))
        if np.linalg.norm(step) < 1e-6:
            return Solution(s, t, nodes, normal, axes)
    raise RuntimeError("the published estimator did not converge")


def errors_against(solution: Solution, truth: list[Stream]) -> Array:
    """RMSE in m and in rad, a row for each stream and a last one for all of them together."""
    off = []
    for _, time, place, values in truth:
        keep = (time >= solution.t[0]) & (time <= solution.t[-1])
        a, b = se3_exp(values[keep]), solution.pose_at(place[keep], time[keep])
        off.append(np.linalg.norm([b[:, :3, 3] - a[:, :3, 3], between(a, b)[:, 3:]], axis=2).T)
    return np.array([np.sqrt(np.mean(x**2, 0)) for x in [*off, np.concatenate(off)]])
