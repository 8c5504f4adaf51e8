"""What `_kernels.rod_flow` computes in loops, by arrays over the intervals: (26) and (27)."""

from __future__ import annotations

import numpy as np

from glissando._kernels.rod_flow import STEPS
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.mechanical.flow import Flow, Section

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_TERMS = 6  # of the exponential of a step, whose norm is small


@np.errstate(over="ignore", invalid="ignore")  # a step too long leads anywhere, and is refused
def flow(rotation: Array, wrench: Array, step: Array, section: Section, *, noisy: bool) -> Flow:
    """What `model.priors.mechanical.flow.flow` returns."""
    count, part = len(step), step / STEPS
    pose = np.broadcast_to(np.eye(4), (count, 4, 4))
    phi = np.broadcast_to(np.eye(12), (count, 12, 12))
    noise, by_weight = np.zeros((count, 12, 12)), np.zeros((count, 12, 6))
    for i in range(STEPS):
        here, turn = section.ahead(i * part), rotation @ pose[:, :3, :3]
        middle = 0.5 * part[:, None]
        weight = np.einsum("mji,mj->mi", turn, here.weight + middle * here.weight_slope)
        series = _Series(wrench, weight, here)
        forward, wrench, onward, by_own = series.step(part)
        if noisy:
            noise = onward @ noise @ _transposed(onward) + series.noise(part, here.psd)
        by_world, along = by_own @ _transposed(turn), (i + 0.5) * part[:, None, None]
        by_weight = onward @ by_weight + np.concatenate([by_world, along * by_world], axis=2)
        pose, phi = pose @ forward, onward @ phi
    return Flow(pose, wrench, phi, noise, by_weight)


class _Series:
    """Strain, wrench and weight with their derivatives by arclength, and the slopes of all those.

    Slopes (M, 6, 9) are by [weight, wrench] of the beginning.
    """

    def __init__(self, wrench: Array, weight: Array, section: Section) -> None:
        self.section, self.wrench, self.weight = section, wrench, weight
        compliance = 1.0 / section.stiffness
        none = np.zeros_like(wrench)
        rest = [section.rest, section.rest_slope, none, none]
        self.by_weight = np.zeros((len(wrench), 3, 9))
        self.by_weight[:, :, :3] = np.eye(3)
        self.by_wrench = np.zeros((len(wrench), 6, 9))
        self.by_wrench[:, :, 3:] = np.eye(6)
        wrenches, slopes = [wrench], [self.by_wrench]
        weights, weight_slopes = [weight], [self.by_weight]
        self.strain: list[Array] = []
        self.by_strain: list[Array] = []
        self.ad: list[Array] = []
        self.pull: list[Array] = []
        for order in range(4):
            strain = rest[order] + compliance * wrenches[order]
            self.strain.append(strain)
            self.by_strain.append(compliance[:, :, None] * slopes[order])
            self.ad.append(se3.ad(strain))
            self.pull.append(_pull(wrenches[order]))
            if order == 3:
                break
            # ∂W/∂s = ad(ε)ᵀ W − w_g and ∂w_g/∂s = −u × w_g, differentiated by Leibniz' rule
            change, slope = np.zeros_like(wrench), np.zeros_like(self.by_wrench)
            turn, turn_slope = np.zeros_like(weight), np.zeros_like(self.by_weight)
            for k, times in enumerate(_BINOMIAL[order]):
                j = order - k
                back = _transposed(self.ad[k])
                change += times * _apply(back, wrenches[j])
                slope += times * (back @ slopes[j] + self.pull[j] @ self.by_strain[k])
                spin, heavy = se3.hat3(self.strain[k][:, 3:]), se3.hat3(weights[j])
                turn -= times * _apply(spin, weights[j])
                turn_slope += times * (heavy @ self.by_strain[k][:, 3:] - spin @ weight_slopes[j])
            change[:, :3] -= weights[order]
            slope[:, :3] -= weight_slopes[order]
            wrenches.append(change)
            slopes.append(slope)
            weights.append(turn)
            weight_slopes.append(turn_slope)

    def step(self, h: Array) -> tuple[Array, Array, Array, Array]:
        """Pose (M, 4, 4) and wrench (M, 6) after `h` (M,), slopes of both.

        By pose and wrench of the beginning (M, 12, 12), and by its weight (M, 12, 3).
        """
        a, b = h[:, None], h[:, None, None]
        e0, e1, e2, e3 = self.strain
        d0, d1, d2, d3 = self.by_strain
        ad0, ad1, ad2, _ = self.ad
        ahead = a * e0 + a**2 / 2 * e1 + a**3 / 6 * e2 + a**4 / 24 * e3
        ahead += a**3 / 12 * _apply(ad0, e1) + a**4 / 24 * _apply(ad0, e2)
        slope = b * d0 + b**2 / 2 * d1 + b**3 / 6 * d2 + b**4 / 24 * d3
        slope += b**3 / 12 * (ad0 @ d1 - ad1 @ d0) + b**4 / 24 * (ad0 @ d2 - ad2 @ d0)
        pose, moved = se3.exp(ahead), se3.right_jacobian(ahead) @ slope

        carried, by_carried = self._less_weight(a, b)
        frame = se3.adjoint(pose)
        wrench = _apply(_transposed(frame), carried)
        phi = np.zeros((len(h), 12, 12))
        phi[:, :6, :6] = se3.adjoint(se3.inverse(pose))
        carried_on = _transposed(frame) @ by_carried + _pull(wrench) @ moved
        own = np.concatenate([moved, carried_on], axis=1)
        phi[:, :, 3:6] += own[:, :, :3] @ se3.hat3(self.weight)
        phi[:, :, 6:] += own[:, :, 3:]
        return pose, wrench, phi, own[:, :, :3]

    def _less_weight(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Wrench (M, 6) less the weight over a step, both about its beginning; slope (M, 6, 9)."""
        weight, strain, change = self.weight, self.strain[0], self.strain[1]
        turning = change[:, :3] + np.cross(strain[:, 3:], strain[:, :3])
        lever = a**2 / 2 * strain[:, :3] + a**3 / 6 * turning
        spin, along = se3.hat3(strain[:, 3:]), se3.hat3(strain[:, :3])
        d0, d1 = self.by_strain[:2]
        bent = d1[:, :3] + spin @ d0[:, :3] - along @ d0[:, 3:]
        by_lever = b**2 / 2 * d0[:, :3] + b**3 / 6 * bent
        carried, slope = self.wrench.copy(), self.by_wrench.copy()
        carried[:, :3] -= a * weight
        carried[:, 3:] -= np.cross(lever, weight)
        slope[:, :3] -= b * self.by_weight
        slope[:, 3:] -= se3.hat3(lever) @ self.by_weight - se3.hat3(weight) @ by_lever
        return carried, slope

    def noise(self, h: Array, psd: Array) -> Array:
        """Covariance (M, 12, 12) that white noise of densities `psd` (M, 12) adds over `h` (M,)."""
        generator = np.zeros((len(h), 12, 12))
        middle = 0.5 * h[:, None, None] * self.ad[1] + self.ad[0]
        generator[:, :6, :6] = -middle
        generator[:, :6, 6:] = self._compliance()
        generator[:, 6:9, 3:6] = -se3.hat3(self.weight)
        force = self.pull[0] + 0.5 * h[:, None, None] * self.pull[1]
        generator[:, 6:, 6:] = _transposed(middle) + force @ self._compliance()
        scaled = h[:, None, None] * generator
        powers = [np.broadcast_to(np.eye(12), scaled.shape), scaled]
        for k in range(2, _TERMS):
            powers.append(powers[-1] @ scaled / k)
        root, out = np.sqrt(h[:, None] * psd)[:, None, :], np.zeros_like(scaled)
        for x, weight in zip(_NODES, _WEIGHTS, strict=True):
            lever = np.sum([x**k * power for k, power in enumerate(powers)], axis=0) * root
            out += weight * lever @ _transposed(lever)
        return out

    def _compliance(self) -> Array:
        return np.eye(6) / self.section.stiffness[:, :, None]


_BINOMIAL = [[1], [1, 1], [1, 2, 1]]


def _apply(matrix: Array, vector: Array) -> Array:
    return np.einsum("mij,mj->mi", matrix, vector)


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)


def _pull(wrench: Array) -> Array:
    """B(W) (M, 6, 6) with B(W) η = ad(η)ᵀ W."""
    out = np.zeros((*wrench.shape[:-1], 6, 6))
    force, moment = se3.hat3(wrench[..., :3]), se3.hat3(wrench[..., 3:])
    out[..., :3, 3:] = out[..., 3:, :3] = force
    out[..., 3:, 3:] = moment
    return out
