"""Where along the body confidence is highest, and whether that is where the sensor is."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.experiments.scenes import Scene, Trial, bench, path, trial
from glissando.geometry.se3 import Array

_INSTANTS = 0.35  # s between instants, which fall on and between time nodes
_POINTS = 701  # places along the body at which confidence is asked for


def std_along(found: Trial, time: float) -> tuple[Array, Array]:
    """Arclengths (P,) and the standard deviation of position (P,) there at a time, metres."""
    arclength = np.linspace(0.0, bench().rod.length, _POINTS)
    return arclength, found.posterior.at(arclength, time).std_position


def nearest_minimum(arclength: Array, std: Array, coil: float) -> float:
    """Arclength of the local minimum nearest to the coil; the clamped base is none, the tip may be.

    A minimum must be lower than its neighbours on both sides that exist.
    """
    lower = np.diff(std) < 0.0
    inner = np.flatnonzero(lower[:-1] & ~lower[1:]) + 1
    minima = np.append(inner, std.size - 1) if lower[-1] else inner
    if minima.size == 0:
        return float("nan")
    return float(arclength[minima[np.argmin(np.abs(arclength[minima] - coil))]])


def figure_a(quick: bool) -> tuple[dict[str, Any], dict[str, Trial]]:
    """Straight, C and S, the coil at the tip and 60 mm inside: how far the minimum is from it."""
    results: dict[str, Any] = {}
    trials = {}
    duration = 2.0 if quick else 4.0
    for shape in ("straight", "C", "S"):
        for label, at in (("tip", 0.0), ("inside", 0.06)):
            found = trial(Scene(shape, "hold", duration, at=at), seed=0)
            coil = bench().rod.length - at
            minimum = nearest_minimum(*std_along(found, 0.5 * duration), coil)
            name = f"{shape} {label}"
            results[name] = {"coil": coil, "minimum": minimum, "distance": abs(minimum - coil)}
            trials[name] = found
    return {**results, "worst": max(r["distance"] for r in results.values())}, trials


def figure_b(quick: bool) -> tuple[dict[str, Any], Trial, Scene]:
    """The coil slides the whole length of a C: distance from coil to minimum at several instants.

    The base is clamped, so instants count while the coil is in the outer three quarters.
    """
    length = bench().rod.length
    scene = Scene(
        "C", "traverse", 14.0, speed=0.1, stroke=length, cycles=1, nodes=22, time_rate=5.0
    )
    found, slid = trial(scene, seed=0), path(scene)
    results: dict[str, Any] = {}
    for time in np.arange(0.0, scene.duration + 1e-9, _INSTANTS):
        coil = length - float(slid.at(time))
        if coil < 0.25 * length:
            continue
        minimum = nearest_minimum(*std_along(found, float(time)), coil)
        results[f"{time:g}"] = {"coil": coil, "minimum": minimum, "distance": abs(minimum - coil)}
    distances = [r["distance"] for r in results.values()]
    return {"instants": results, "worst": max(distances)}, found, scene
