"""Poses of a coil in a channel beside the backbone, by the simulated rod's geometry."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_simpson

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.motion import Motion
from glissando.simulation.rod import STRAIGHT, Tendon

_FINE = 801  # points at which a channel's length is integrated


def straight_length(channel: Tendon, length: float) -> float:
    """Length of a channel in the straight rod, m."""
    places = np.linspace(0.0, length, _FINE)
    speed = np.linalg.norm(STRAIGHT[:3] + channel.path(places)[1], axis=-1)
    return float(np.trapezoid(speed, places))


def poses_in(channel: Tendon, motion: Motion | DynamicMotion, travel: Array, time: Array) -> Array:
    """Poses T_wc (M, 4, 4) of a coil at distances along a channel, with z along the channel.

    Beyond an end of the channel the coil continues straight along the tangent.

    Args:
        channel: The channel.
        motion: The robot's motion.
        travel: Distances (M,) of the coil along the channel from the base, m.
        time: Times (M,), s.
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
    speed = np.linalg.norm(_tangent(channel, s, strain), axis=-1)
    lengths = cumulative_simpson(speed, x=s, initial=0.0)
    inside = np.clip(travel, 0.0, lengths[which, -1])
    offset = [np.interp(x, lengths[k], s - lengths[k]) for x, k in zip(inside, which, strict=True)]
    place = np.clip(inside + offset, 0.0, length)
    at = motion.at(place, time)
    tangent = _tangent(channel, place, at.strain)
    axis = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    position = channel.path(place)[0] + (travel - inside)[:, None] * axis
    return at.pose @ se3.pose(se3.least_turn(axis), position)


def _tangent(channel: Tendon, arclength: Array, strain: Array) -> Array:
    """Tangents (…, P, 3), not normalised, of a channel at arclengths (P,), in body frames."""
    place, slope = channel.path(arclength)
    return strain[..., :3] + np.cross(strain[..., 3:], place) + slope
