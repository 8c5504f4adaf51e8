"""Slow, obvious twins of the simulator's statics: shooting on a textbook ODE, elliptic integrals.

No code shared with the package. Body z runs along the rod; six-vectors are [linear, angular]:
strain is [v, u], wrenches are [force n, moment m]. All robots are described for one number s at a
time, with every derivative written out by hand, so that nothing is differenced.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

Array = np.ndarray


@dataclass(frozen=True)
class Pull:
    """A tendon under `tension`; `path(s)` is its place r, slope r' and second slope r'' (3, 3)."""

    path: Callable[[float], Array]
    tension: float
    end: float


def straight(x: float, y: float, tension: float, end: float) -> Pull:
    """A tendon parallel to the backbone."""
    path = np.array([[x, y, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    return Pull(lambda s: path, tension, end)


def helical(radius: float, angle: float, pitch: float, tension: float, end: float) -> Pull:
    """A tendon that winds round the backbone once every `pitch`, from `angle` at s = 0."""
    rate = 2.0 * np.pi / pitch

    def path(s: float) -> Array:
        cos, sin = np.cos(angle + rate * s), np.sin(angle + rate * s)
        place, slope = np.array([cos, sin, 0.0]), np.array([-sin, cos, 0.0])
        return radius * np.array([place, rate * slope, -(rate**2) * place])

    return Pull(path, tension, end)


class Point(NamedTuple):
    """A dead load at s > 0: force and moment in the world frame."""

    arclength: float
    force: Array
    moment: Array


@dataclass(frozen=True)
class Robot:
    """All there is to know; `rest(s)` is the unloaded strain and its slope (2, 6)."""

    length: float
    stiffness: Array
    rest: Callable[[float], Array]
    base: Array
    weight: Array  # N/m, world
    pulls: tuple[Pull, ...] = ()
    points: tuple[Point, ...] = ()

    def loaded(self, share: float) -> "Robot":
        """This robot under a share of its loads."""
        return replace(
            self,
            weight=share * self.weight,
            pulls=tuple(replace(p, tension=share * p.tension) for p in self.pulls),
            points=tuple(Point(p[0], share * p.force, share * p.moment) for p in self.points),
        )

    @property
    def breaks(self) -> list[float]:
        """Both ends and the places where a point load acts or a tendon ends, in order."""
        inner = [p.end for p in self.pulls] + [p.arclength for p in self.points]
        return sorted({0.0, self.length, *inner})

    @cached_property
    def unit(self) -> Array:
        """Wrench (6,) in which what the material carries is counted."""
        return self.stiffness[3] * np.repeat([1.0 / self.length**2, 1.0 / self.length], 3)

    def strain(self, s: float, state: Array) -> Array:
        """Strain (6,) from what the material carries."""
        return self.rest(s)[0] + self.unit * state[12:] / self.stiffness


class Rods(NamedTuple):
    """Cross-sections: pose (M, 4, 4), strain (M, 6), wrench (M, 6) in the material, body frame."""

    pose: Array
    strain: Array
    wrench: Array


def hat(w: Array) -> Array:
    """The matrix of the cross product w x."""
    a, b, c = w
    return np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def rucker_webster(robot: Robot, arclength: Array, shares: tuple[float, ...] = (0.5, 1.0)) -> Rods:
    """The static shape of a tendon robot after Rucker and Webster 2011, shot from its base.

    The unknown is what the material carries at the base; it is right when nothing is left to carry
    beyond the tip. Loads are put on in `shares`, each solved from the one before. At a break the
    cross-section beyond it is reported, at the tip the one before it.
    """
    carried = np.zeros(6)
    for share in shares:
        part = robot.loaded(share)
        guess = carried + tendons_at_base(part)
        found = root(
            lambda x, part=part: shoot(part, x)[1], guess, tol=1e-11, options={"eps": 1e-12}
        )
        assert np.abs(found.fun).max() < 1e-8, found.message
        carried = found.x - tendons_at_base(part)
    pieces = shoot(robot, found.x)[0]
    states = []
    for s in arclength:
        piece = min(np.searchsorted(robot.breaks, s, side="right"), len(pieces)) - 1
        states.append(pieces[piece](s))
    return sections(robot, np.asarray(arclength), np.array(states))


def tendons_at_base(robot: Robot) -> Array:
    """What the material would carry at the base if only tendons pulled and nothing bent."""
    return -tendon_wrench(robot.pulls, 0.0, robot.rest(0.0)[0]) / robot.unit


def shoot(robot: Robot, carried: Array) -> tuple[list, Array]:
    """States y(s) of every piece between breaks, and what is left to carry beyond the tip.

    A state is position, rotation and what the material carries, K (strain - rest), in units of
    the bending stiffness: beside stiff extension, a strain near 1 would have no digits left.
    """
    state = np.concatenate([robot.base[:3, 3], robot.base[:3, :3].ravel(), carried])
    pieces = []
    for low, high in pairwise(robot.breaks):
        solved = solve_ivp(
            lambda s, y, low=low: derivative(robot, s, y, low),
            (low, high),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-11,
            dense_output=True,
        )
        pieces.append(solved.sol)
        state = solved.y[:, -1].copy()
        state[12:] = beyond(robot, high, state)
    return pieces, state[12:]


def beyond(robot: Robot, s: float, state: Array) -> Array:
    """What the material carries (6,) just beyond a break, from the state just before it.

    Less by the point loads and by the pull F = -tau t, L = r x F of every tendon that ends here.
    A tendon that goes on has a kink where strain jumps, so that its distributed force tau t' has
    a point force tau (t_beyond - t_before) in it; parallel tendons of a stiff rod hardly have one.
    """
    turn = state[3:12].reshape(3, 3)
    here = [pull for pull in robot.pulls if pull.end >= s]
    on = [pull for pull in robot.pulls if pull.end > s]
    left = robot.unit * state[12:] + tendon_wrench(here, s, robot.strain(s, state))
    for point in robot.points:
        if point.arclength == s:
            left -= np.concatenate([turn.T @ point.force, turn.T @ point.moment])

    def excess(carried: Array) -> Array:
        strain = robot.rest(s)[0] + robot.unit * carried / robot.stiffness
        return carried + (tendon_wrench(on, s, strain) - left) / robot.unit

    found = root(excess, state[12:], tol=1e-14)
    assert np.abs(found.fun).max() < 1e-10, found.message
    return found.x


def tendon_wrench(pulls: Sequence[Pull], s: float, strain: Array) -> Array:
    """Sum of tau [t; r x t] (6,), with which tendons pull on what lies before s."""
    total, (v, u) = np.zeros(6), strain.reshape(2, 3)
    for pull in pulls:
        place, slope, _ = pull.path(s)
        along = np.cross(u, place) + slope + v
        force = pull.tension * along / np.linalg.norm(along)
        total += np.concatenate([force, np.cross(place, force)])
    return total


def derivative(robot: Robot, s: float, state: Array, low: float) -> Array:
    """The ODE of Rucker and Webster: p', R', and v', u' from A, B, G, H, c, d.

    A tendon acts if it ends beyond `low`, where the piece begins.
    """
    turn, (v, u) = state[3:12].reshape(3, 3), robot.strain(s, state).reshape(2, 3)
    n, m = (robot.unit * state[12:]).reshape(2, 3)
    rest_slope, u_hat = robot.rest(s)[1], hat(u)
    A, B, G, H = np.zeros((4, 3, 3))
    a, b = np.zeros((2, 3))
    for pull in robot.pulls:
        if pull.end > low:
            place, slope, bend = pull.path(s)
            along = u_hat @ place + slope + v  # p_i' in the body frame
            turned = hat(along)
            A_i = -pull.tension * turned @ turned / np.linalg.norm(along) ** 3
            a_i = A_i @ (u_hat @ along + u_hat @ slope + bend)
            r = hat(place)
            A += A_i
            B += r @ A_i
            G -= A_i @ r
            H -= r @ A_i @ r
            a += a_i
            b += r @ a_i
    K = robot.stiffness  # the diagonal
    d = K[:3] * rest_slope[:3] - u_hat @ n - turn.T @ robot.weight - a
    c = K[3:] * rest_slope[3:] - u_hat @ m - hat(v) @ n - b
    whole = np.diag(K)
    whole[:3, :3] += A
    whole[:3, 3:] = G
    whole[3:, :3] = B
    whole[3:, 3:] += H
    strain_slope = np.linalg.solve(whole, np.concatenate([d, c]))
    carried_slope = K * (strain_slope - rest_slope) / robot.unit
    return np.concatenate([turn @ v, (turn @ u_hat).ravel(), carried_slope])


def sections(robot: Robot, arclength: Array, states: Array) -> Rods:
    """Cross-sections of states (M, 18)."""
    pose = np.tile(np.eye(4), (len(states), 1, 1))
    pose[:, :3, 3] = states[:, :3]
    pose[:, :3, :3] = states[:, 3:12].reshape(-1, 3, 3)
    strain = np.array([robot.strain(s, y) for s, y in zip(arclength, states, strict=True)])
    return Rods(pose, strain, robot.unit * states[:, 12:])


def elastica(load: float) -> tuple[float, float]:
    """Tip of a cantilever of length 1 under a transverse dead force: (along, across).

    `load` is F L^2 / (E I), up to 300; bending only. Bisshopp and Drucker 1945: with
    1 + sin(slope) = 2 k^2 sin^2(phi), the parameter k is where K(k) - F(phi_base, k) =
    sqrt(load).
    """

    def base(m: float) -> float:
        return np.arcsin(np.sqrt(0.5 / m))

    def excess(m: float) -> float:
        return ellipk(m) - ellipkinc(base(m), m) - np.sqrt(load)

    m = brentq(excess, 0.5 + 1e-15, 1.0 - 1e-15, xtol=1e-16)
    along = np.sqrt(2.0 / load * (2.0 * m - 1.0))
    across = 1.0 - 2.0 / np.sqrt(load) * (ellipe(m) - ellipeinc(base(m), m))
    return along, across


def arc(
    length: float, stiffness: Array, offset: Array, tension: float, end: float, arclength: Array
) -> Array:
    """Poses (M, 4, 4) of a straight rod that one parallel tendon of `offset` (2,) bends.

    Up to its end the rod is an arc of constant curvature, shortened by the pull; beyond, it is
    straight and unloaded. `stiffness` has one bending stiffness for both directions.
    """
    assert stiffness[3] == stiffness[4]
    assert end <= length
    out = np.tile(np.eye(4), (len(arclength), 1, 1))
    stretch = 1.0 - tension / stiffness[2]
    bend = tension * np.linalg.norm(offset) / stiffness[3]  # rad per metre of s, to the tendon
    way = np.append(offset / np.linalg.norm(offset), 0.0)
    for pose, s in zip(out, arclength, strict=True):
        angle = bend * min(s, end)
        cos, sin, up = np.cos(angle), np.sin(angle), np.array([0.0, 0.0, 1.0])
        tangent = sin * way + cos * up
        pose[:3, 3] = stretch / bend * ((1.0 - cos) * way + sin * up)
        pose[:3, 3] += max(s - end, 0.0) * tangent
        pose[:3, :3] = np.eye(3) + sin * hat(np.cross(up, way))
        pose[:3, :3] += (1.0 - cos) * hat(np.cross(up, way)) @ hat(np.cross(up, way))
    return out
