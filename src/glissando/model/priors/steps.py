"""One step between two nodes: the errors the prior penalises, and the point between them.

A step goes along arclength (the pose moves by its strain, the velocity is carried rigidly) or along
time (the pose moves by its velocity, the strain stays). `Direction` assigns the components of a
node to these roles, so that both directions share their code.
"""

from __future__ import annotations

from dataclasses import dataclass

from glissando._kernels import static_steps as still
from glissando._kernels import steps as kernels
from glissando._kernels.arrays import whole
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.state import STRAIN, VELOCITY, State

Densities = tuple[Array, Array, Array]
"""Densities (M, 6) of the moving and of the carried field in steps, variance of a jump."""


@dataclass(frozen=True)
class Direction:
    """Along arclength or along time: which field moves the pose, which is carried, and how.

    Attributes:
        rate: Components of a node that move the pose.
        carried: Components of the other field.
        rigid: Whether the other field is carried rigidly with the body.
    """

    name: str
    rate: slice
    carried: slice
    rigid: bool

    def rate_of(self, state: State) -> Array:
        """The field (…, 6) that moves the pose along this direction."""
        return state.strain if self.rate == STRAIN else state.velocity

    def carried_of(self, state: State) -> Array:
        """The other field (…, 6)."""
        return state.velocity if self.rate == STRAIN else state.strain


ARCLENGTH = Direction("arclength", STRAIN, VELOCITY, rigid=True)
TIME = Direction("time", VELOCITY, STRAIN, rigid=False)

Whitened = tuple[Array, Array, Array]
"""Errors (M, r) of steps, Jacobians (M, r, 2, 18) by both ends, and whiteners (M, r, r)."""


def weighted_steps(
    direction: Direction,
    flat: State,
    noise_state: State,
    nodes: Index,
    step: Array,
    weight: Array,
    densities: Densities,
) -> tuple[Whitened, Whitened]:
    """Errors of steps, of the pair [pose, rate] (r = 12) and of the carried field (r = 6).

    Pair: e = [log(exp(h rate₀)⁻¹ T₀⁻¹ T₁); rate₁ − rate₀] (equation 2'). Carried: along arclength
    ϖ₁ − Ad(T₁⁻¹ T₀) ϖ₀ (equation 3'), along time ε₁ − ε₀ (equation 4).

    Args:
        direction: Along arclength or time.
        flat: States (L,) in which nodes are indices.
        noise_state: States (L,) at whose rates the noise is evaluated; errors are in its axes if
            densities are equal in x and y (equation 35).
        nodes: Indices (M, 2) of both ends of each step.
        step: Lengths (M,), metres or seconds.
        weight: Factors (M,) on the whiteners.
        densities: Densities of the noise.
    """
    fields = flat.pose, direction.rate_of(flat), direction.carried_of(flat)
    whitened = kernels.weighted_steps(
        *map(whole, (*fields, direction.rate_of(noise_state), nodes, step, weight, *densities)),
        direction.rigid,
        flat.rolls_from(noise_state),
    )
    return whitened[:3], whitened[3:]


def static_steps(
    flat: State, nodes: Index, step: Array, psd: Array, jump: Array
) -> tuple[Array, Array, Array]:
    """Errors (M, 12) of arclength steps of static shapes. Source: equation (2').

    Args:
        flat: States (L,) in which nodes are indices.
        nodes: Indices (M, 2) of both ends of each step.
        step: Lengths (M,), metres.
        psd: Densities (M, 6) of strain.
        jump: Variances (M, 6) of strain's jump at the end.

    Returns:
        Errors, Jacobians (M, 12, 2, 12) by pose and strain of both ends, whiteners (M, 12, 12).
    """
    error, jacobian, whitener = still.static_steps(
        *map(whole, (flat.pose, flat.strain, nodes, step, psd, jump)), False
    )
    return error, jacobian, whitener
