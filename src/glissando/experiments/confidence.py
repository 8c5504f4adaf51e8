"""Comparison of the coil's arclength with that of the least standard deviation of position."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.experiments.scenes import PAPER_RATE, Scene, Trial, bench, path, trial
from glissando.geometry.se3 import Array

_INSTANTS = 0.35  # s between instants, which lie on and between time nodes
_POINTS = 701  # arclengths at which standard deviations are evaluated


def std_along(result: Trial, time: float) -> tuple[Array, Array]:
    """Arclengths (P,) along the body, m, and the std of position (P,) there at a time, m."""
    arclength = np.linspace(0.0, bench().rod.length, _POINTS)
    return arclength, result.posterior.at(arclength, time).std_position


def nearest_minimum(arclength: Array, std: Array, coil: float) -> float:
    """Arclength of the local minimum of `std` nearest to the coil; NaN if there is no minimum.

    A minimum is lower than its neighbours. The tip, which has one neighbour, may be a minimum; the
    clamped base is excluded.
    """
    falls = np.diff(std) < 0.0
    minima = np.flatnonzero(falls[:-1] & ~falls[1:]) + 1
    if falls[-1]:
        minima = np.append(minima, std.size - 1)
    if minima.size == 0:
        return float("nan")
    return float(arclength[minima[np.argmin(np.abs(arclength[minima] - coil))]])


def _minimum_near(result: Trial, time: float, coil: float) -> dict[str, float]:
    minimum = nearest_minimum(*std_along(result, time), coil)
    return {"coil": coil, "minimum": minimum, "distance": abs(minimum - coil)}


def confidence_at_coil(quick: bool) -> tuple[dict[str, Any], dict[str, Trial]]:
    """Compare coil and minimum for straight, C and S shapes, with the coil at the tip and inside.

    Args:
        quick: Whether sessions last 2 s instead of 4 s.

    Returns:
        Arclengths of coil and minimum and their distance (m) by name, and the `worst` distance; the
        trials by the same names.
    """
    results: dict[str, Any] = {}
    trials = {}
    duration = 2.0 if quick else 4.0
    for shape in ("straight", "C", "S"):
        for label, at in (("tip", 0.0), ("inside", 0.06)):
            name = f"{shape} {label}"
            scene = Scene(shape, "hold", duration, at=at, time_rate=PAPER_RATE)
            trials[name] = trial(scene, seed=0)
            coil = bench().rod.length - at
            results[name] = _minimum_near(trials[name], 0.5 * duration, coil)
    return {**results, "worst": max(r["distance"] for r in results.values())}, trials


def confidence_follows() -> tuple[dict[str, Any], Trial, Scene]:
    """Compare coil and minimum over time, while the coil slides the whole length of a C.

    As the base is clamped, only instants count at which the coil is in the outer three quarters.

    Returns:
        Comparisons (m) by time under `instants`, and the `worst` distance; the trial; its scene.
    """
    length = bench().rod.length
    scene = Scene(
        "C", "traverse", 14.0, speed=0.1, stroke=length, cycles=1, nodes=22, time_rate=5.0
    )
    result, slide = trial(scene, seed=0), path(scene)
    instants: dict[str, Any] = {}
    for time in np.arange(0.0, scene.duration + 1e-9, _INSTANTS):
        coil = length - float(slide.at(time))
        if coil >= 0.25 * length:
            instants[f"{time:g}"] = _minimum_near(result, float(time), coil)
    worst = max(entry["distance"] for entry in instants.values())
    return {"instants": instants, "worst": worst}, result, scene
