"""Where a coil is in a channel beside the backbone, by the simulated rod's own geometry."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_simpson

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.motion import Motion
from glissando.simulation.rod import STRAIGHT, Tendon

_FINE = 801  # places along a channel whose length is asked for


def straight_length(channel: Tendon, length: float) -> float:
    """Length of a channel in the straight rod, m."""
    places = np.linspace(0.0, length, _FINE)
    speed = np.linalg.norm(STRAIGHT[:3] + channel.path(places)[1], axis=-1)
    return float(np.trapezoid(speed, places))


def poses_in(channel: Tendon, motion: Motion | DynamicMotion, travel: Array, time: Array) -> Array:
    """Poses T_wc (M, 4, 4) after travels (M,) from the base, z along the channel.

    Beyond an end of the channel the coil goes straight on.

    Args:
        channel: The channel.
        motion: The robot's motion.
        travel: How far the coil was pushed in, m.
        time: When (M,), s.
    """
    mesh, length = motion.mesh, motion.rod.length
    instants, which = np.unique(time, return_inverse=True)
    s = np.linspace(0.0, length, _FINE)
    strain = np.stack(
        [
            mesh.interpolate(np.broadcast_to(each, (s.size, *each.shape)), s)
            for each in motion.strains(instants)
        ]
    )
    speed = np.linalg.norm(_along(channel, s, strain), axis=-1)
    way = cumulative_simpson(speed, x=s, initial=0.0)
    inside = np.clip(travel, 0.0, way[which, -1])
    behind = [np.interp(x, way[k], s - way[k]) for x, k in zip(inside, which, strict=True)]
    place = np.clip(inside + behind, 0.0, length)
    at = motion.at(place, time)
    tangent = _along(channel, place, at.strain)
    axis = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    position = channel.path(place)[0] + (travel - inside)[:, None] * axis
    return at.pose @ se3.pose(se3.least_turn(axis), position)


def _along(channel: Tendon, arclength: Array, strain: Array) -> Array:
    """Tangent (…, P, 3) of a channel at arclengths (P,) in the rod's frame there."""
    place, slope = channel.path(arclength)
    return strain[..., :3] + np.cross(strain[..., 3:], place) + slope
