"""Residual of the balance of forces and moments of a moving rod at its Gauss points.

Source: docs/dynamics.md, "Equations of motion".
"""

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from glissando._kernels.jit import jit
from glissando._kernels.rod_motion import (
    crossed,
    integrate_into,
    rates_into,
    roll_out_into,
    turned,
    turned_back,
)

_SLOW = 1e-3  # m/s of sliding at which a contact's friction is 0.7 of Coulomb's


@jit()
def _pulls_into(state, before, weights, paths, cables, pull, unit, stretch):
    """Tensions (T, G), tangents (T, G, 3) and stretches (T, G) of tendons.

    `paths` (T, 3, G, 3) are their positions, derivatives, and 1 where they run; `cables` (T, 4) are
    tension at natural length (N), stiffness (N/m), natural length (m) and friction.
    """
    points = state.shape[1]
    bend = np.empty(points)
    for j in range(paths.shape[0]):
        length = 0.0
        for g in range(points):
            a, b, c = state[0, g, 3], state[0, g, 4], state[0, g, 5]
            x, y, z = crossed(a, b, c, paths[j, 0, g, 0], paths[j, 0, g, 1], paths[j, 0, g, 2])
            x += state[0, g, 0] + paths[j, 1, g, 0]
            y += state[0, g, 1] + paths[j, 1, g, 1]
            z += state[0, g, 2] + paths[j, 1, g, 2]
            size = sqrt(x * x + y * y + z * z)
            stretch[j, g] = size
            length += weights[g] * size * paths[j, 2, g, 0]
            x, y, z = x / size, y / size, z / size
            unit[j, g, 0], unit[j, g, 1], unit[j, g, 2] = x, y, z
            x, y, z = crossed(a, b, c, x, y, z)
            bend[g] = sqrt(x * x + y * y + z * z)
        tension = max(0.0, cables[j, 0] + cables[j, 1] * (length - cables[j, 2]))
        for g in range(points):
            angle = 0.0
            if cables[j, 3] > 0.0:
                for h in range(points):
                    angle += before[g, h] * bend[h]
            pull[j, g] = tension * exp(-cables[j, 3] * angle) * paths[j, 2, g, 0]


@jit()
def _contacts_into(place, rates, planes, sites, touch, ends):
    """Contact forces a metre (1, G, 3), into `touch`, and wrenches at elements' ends (E, 6).

    `planes` (C, 9): point, normal, stiffness N/m², damping s/m, friction of half-spaces, with the
    force of Hunt and Crossley 1975, equation (14), and Coulomb's friction. `sites` (H, 12):
    element, dead force and moment, anchor, stiffness N/m and damping N s/m of a spring.
    """
    points = touch.shape[1]
    for g in range(points):
        touch[0, g, 0] = touch[0, g, 1] = touch[0, g, 2] = 0.0
        for c in range(planes.shape[0]):
            depth = speed = square = 0.0
            for i in range(3):
                depth -= planes[c, 3 + i] * (place[g, i] - planes[c, i])
                speed -= planes[c, 3 + i] * rates[0, g, i]
            if depth > 0.0:
                press = planes[c, 6] * depth * max(0.0, 1.0 + planes[c, 7] * speed)
                for i in range(3):
                    square += (rates[0, g, i] + speed * planes[c, 3 + i]) ** 2
                drag = planes[c, 8] * press / sqrt(square + _SLOW * _SLOW)
                for i in range(3):
                    slide = rates[0, g, i] + speed * planes[c, 3 + i]
                    touch[0, g, i] += press * planes[c, 3 + i] - drag * slide
    for e in range(ends.shape[0]):
        for i in range(6):
            ends[e, i] = 0.0
    for k in range(sites.shape[0]):
        e = int(sites[k, 0])
        for i in range(6):
            ends[e, i] += sites[k, 1 + i]
        for i in range(3):
            pull = sites[k, 10] * (sites[k, 7 + i] - place[points + e, i])
            ends[e, i] += pull - sites[k, 11] * rates[0, points + e, i]


@jit()
def _inertia_into(turn, rates, section, gravity, touch, acting):
    """Force and moment a metre (2, G, 3) of weight, air, contact and inertia."""
    for g in range(touch.shape[1]):
        for i in range(3):
            acting[0, g, i] = section[2, 0] * (gravity[i] - rates[2, g, i])
            acting[0, g, i] += touch[0, g, i] - section[2, 4] * rates[0, g, i]
        p, q, r = turned_back(turn, g, rates[1, g, 0], rates[1, g, 1], rates[1, g, 2])
        x, y, z = turned_back(turn, g, rates[3, g, 0], rates[3, g, 1], rates[3, g, 2])
        a, b, c = section[2, 1], section[2, 2], section[2, 3]
        u, v, w = crossed(p, q, r, a * p, b * q, c * r)
        x, y, z = turned(turn, g, a * x + u, b * y + v, c * z + w)
        acting[1, g, 0], acting[1, g, 1], acting[1, g, 2] = -x, -y, -z


@jit()
def _carried_into(beyond, along, acting, ends, carried):
    """Internal force and moment (2, G + 1, 3) at the points and, last, at the base."""
    points, elements = acting.shape[1], ends.shape[0]
    count = points // elements
    for kind in range(2):
        for g in range(points + 1):
            x = y = z = 0.0
            for e in range(g // count if g < points else 0, elements):
                x += ends[e, 3 * kind]
                y += ends[e, 3 * kind + 1]
                z += ends[e, 3 * kind + 2]
            carried[kind, g, 0], carried[kind, g, 1], carried[kind, g, 2] = x, y, z
        integrate_into(beyond, acting[kind], carried, kind)
        if kind == 0:
            for g in range(points):
                a, b, c = carried[0, g, 0], carried[0, g, 1], carried[0, g, 2]
                x, y, z = crossed(along[g, 0], along[g, 1], along[g, 2], a, b, c)
                acting[1, g, 0] += x
                acting[1, g, 1] += y
                acting[1, g, 2] += z


@jit()
def _residual_into(state, rest, section, paths, turn, carried, pull, unit, out):
    """Residual wrench (G, 6): material, dampers and tendons, less inertia and loads."""
    for g in range(state.shape[1]):
        for i in range(6):
            out[g, i] = section[0, i] * (state[0, g, i] - rest[g, i])
            out[g, i] += section[1, i] * state[1, g, i]
        for k in range(2):
            x, y, z = carried[k, g, 0], carried[k, g, 1], carried[k, g, 2]
            x, y, z = turned_back(turn, g, x, y, z)
            out[g, 3 * k] -= x
            out[g, 3 * k + 1] -= y
            out[g, 3 * k + 2] -= z
        for j in range(paths.shape[0]):
            a, b, c = unit[j, g, 0], unit[j, g, 1], unit[j, g, 2]
            x, y, z = crossed(paths[j, 0, g, 0], paths[j, 0, g, 1], paths[j, 0, g, 2], a, b, c)
            tension = pull[j, g]
            out[g, 0] += tension * a
            out[g, 1] += tension * b
            out[g, 2] += tension * c
            out[g, 3] += tension * x
            out[g, 4] += tension * y
            out[g, 5] += tension * z


@jit(
    "(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], "
    "f8[:,:,:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1])"
)
def balance(
    state, steps, widths, before, beyond, weights, rest, section, paths,
    base, base_rates, gravity, cables, planes, sites,
):  # fmt: skip
    """Residual (G, 6) of the balance of a rod, followed by intermediate results.

    `state` (3, G, 6) is strain and its two derivatives by time. `before` (S, G) integrates from the
    base to the places, `beyond` (G + 1, G) from the points, and last from the base, to the tip;
    `weights` (G,) are quadrature weights. `section` (3, 6) has stiffness; damping;
    kg/m, rotary inertia (3,) and air damping. `base_rates` (4, 3) are those of the base's pose.
    For the others see the functions above; `rod_equations.Balance` names the results.
    """
    size, points, tendons = before.shape[0], before.shape[1], paths.shape[0]
    turn, place, rates = np.empty((size, 3, 3)), np.empty((size, 3)), np.empty((4, size, 3))
    along, touch = np.empty((points, 3)), np.empty((1, points, 3))
    ends = np.empty((size - points, 6))
    acting, carried = np.empty((2, points, 3)), np.empty((2, points + 1, 3))
    pull, stretch = np.empty((tendons, points)), np.empty((tendons, points))
    unit, out = np.empty((tendons, points, 3)), np.empty((points, 6))
    roll_out_into(state, base, steps, widths, turn, place)
    rates_into(state, base_rates, before, turn, along, rates)
    _contacts_into(place, rates, planes, sites, touch, ends)
    _inertia_into(turn, rates, section, gravity, touch, acting)
    _carried_into(beyond, along, acting, ends, carried)
    _pulls_into(state, before, weights, paths, cables, pull, unit, stretch)
    _residual_into(state, rest, section, paths, turn, carried, pull, unit, out)
    return out, turn, place, rates, along, carried, touch, ends, pull, unit, stretch
