"""Random robots with tendons and loads, each with its twin for the shooting oracle."""

import numpy as np
from hypothesis import settings

from draws import directions, law, poses, sixes
from glissando.simulation import Loads, Rod, Tendon, Wrench, solve_shape
from oracles import rods

LOADS = ("parallel", "helical", "gravity", "tip", "middle")
STRAIGHT = np.array([0.0, 0, 1, 0, 0, 0])
few = settings(law, max_examples=15)


def beam(length=1.0, bending=1.0, *, stiff=1e9, **more):
    """A rod that only bends."""
    return Rod(length, np.array([stiff, stiff, stiff, bending, bending, bending]), **more)


def any_robot(rng, *features):
    """A robot with these features, under loads that bend it by a radian or so, and its twin.

    Features are those of LOADS and "bent" or "curved", which is initial curvature, constant or
    not. Shear and extension are anything from soft to stiff.
    """
    length, bending = round(rng.uniform(0.3, 0.7), 3), 0.02 * rng.uniform(0.5, 2.0, 3)
    stiffness = np.append(10.0 ** rng.uniform(2.0, 4.5, 3), bending)
    force, moment = bending.min() / length**2, bending.min() / length
    rest, rod_rest = any_rest_strain(rng, features)
    base, mass = poses(rng), 0.03
    weight = rng.uniform(0.5, 2.5) * force / length * directions(rng) * ("gravity" in features)

    pulls, tendons = [], []
    for _ in range(3 * ("parallel" in features)):
        radius, angle = rng.uniform(4e-3, 9e-3), rng.uniform(-np.pi, np.pi)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        end, tension = place_on(rng, length, 0.2, 1.0), rng.uniform(0.1, 0.8) * moment / radius
        pulls.append(rods.straight(x, y, tension, end))
        tendons.append(Tendon(np.array([x, y]), end))
    for _ in range("helical" in features):
        radius, angle = rng.uniform(4e-3, 9e-3), rng.uniform(-np.pi, np.pi)
        end, tension = place_on(rng, length, 0.2, 1.0), rng.uniform(0.5, 1.2) * moment / radius
        pitch = rng.choice([-1.0, 1.0]) * length / rng.uniform(0.3, 2.0)
        pulls.append(rods.helical(radius, angle, pitch, tension, end))
        tendons.append(Tendon.helical(radius, angle, pitch, end))

    places = [length] * ("tip" in features)
    places += [place_on(rng, length, 0.3, 0.7)] * ("middle" in features)
    points = tuple(
        rods.Point(
            s,
            rng.uniform(0.3, 1.0) * force * directions(rng),
            rng.uniform(0.3, 1.0) * moment * directions(rng),
        )
        for s in places
    )
    rod = Rod(length, stiffness, rest_strain=rod_rest, mass_per_length=mass, base=base)
    loads = Loads([p.tension for p in pulls], weight / mass, [Wrench(*p) for p in points])
    twin = rods.Robot(length, stiffness, rest, base, weight, tuple(pulls), points)
    return rod, tendons, loads, twin


def place_on(rng, length, low, high):
    """A place on a rod, to the millimetre: the mesh rounds its edges, and a break is only there."""
    return round(length * rng.uniform(low, high), 3)


def any_rest_strain(rng, features):
    """Unloaded strain for the twin, (2, 6) at one s with its slope, and for the rod."""
    mean, swing, rate = STRAIGHT.copy(), np.zeros(6), 8.0
    if "bent" in features or "curved" in features:
        mean += sixes(rng, reach=0.02, angle=1.5)
    if "curved" in features:
        swing = sixes(rng, reach=0.02, angle=1.0)

    def twin(s):
        return np.array([mean + swing * np.sin(rate * s), rate * swing * np.cos(rate * s)])

    def rod(s):
        return mean + swing * np.sin(rate * s[:, None])

    return twin, rod if "curved" in features else mean


def any_solved(rng, *features):
    rod, tendons, loads, _ = any_robot(rng, *(features or LOADS))
    return rod, tendons, loads, solve_shape(rod, tendons, loads)
