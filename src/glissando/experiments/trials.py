"""Many trials of many scenes on all cores, and what they say with 95 % confidence intervals."""

from __future__ import annotations

import multiprocessing
import os
import signal
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from glissando.errors import NotConvergedWarning
from glissando.evaluation.metrics import pool
from glissando.experiments.scenes import Scene, trial
from glissando.geometry.se3 import Array

COLUMNS = ("position", "rotation", "nees", "coverage", "converged")
"""What a trial leaves: RMSE over the body (m, rad), NEES per dof, share inside 95 %, 1 or 0."""
_CHUNK = 4  # seeds a task
_RESAMPLES = 4000

Progress = Callable[[int, int], None]
"""Called with the number of trials done and of all."""


def run_trials(
    plan: Sequence[tuple[Scene, int]], progress: Progress | None = None
) -> dict[Scene, Array]:
    """Outcomes (S, 5) of every scene with seeds 0 to S − 1; the same on any number of cores."""
    seeds = dict[Scene, int]()
    for scene, count in plan:
        seeds[scene] = max(count, seeds.get(scene, 0))
    tasks = [
        (scene, range(first, min(first + _CHUNK, count)))
        for scene, count in seeds.items()
        for first in range(0, count, _CHUNK)
    ]
    out = {scene: np.full((count, len(COLUMNS)), np.nan) for scene, count in seeds.items()}
    done, whole = 0, sum(seeds.values())
    context = multiprocessing.get_context("spawn")
    # as many threads as processes would wait for each other
    with ProcessPoolExecutor(_workers(), mp_context=context, initializer=_quietly) as workers:
        running = {workers.submit(_outcomes, *task): task for task in tasks}
        try:
            for future in as_completed(running):
                scene, rows = running[future]
                out[scene][rows.start : rows.stop] = future.result()
                done += len(rows)
                if progress is not None:
                    progress(done, whole)
        except BaseException:
            workers.shutdown(wait=False, cancel_futures=True)
            raise
    return out


def _quietly() -> None:
    """In a worker: one BLAS thread, and an interrupt is for the process that started it."""
    threadpool_limits(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _workers() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _outcomes(scene: Scene, seeds: range) -> list[list[float]]:
    rows = []
    for seed in seeds:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotConvergedWarning)  # counted in the last column
            found = trial(scene, seed)
        told = pool(found.errors).summary()
        keys = ("position_rmse", "rotation_rmse", "nees_position", "coverage95_position")
        values = [told[key] for key in keys]
        assert all(value is not None for value in values)
        rows.append([float(v or 0.0) for v in values] + [float(found.posterior.solve.converged)])
    return rows


def summary(outcomes: Array, fixed: Array | None = None) -> dict[str, Any]:
    """RMSE, NEES and coverage over seeds, and the change of RMSE in % against a fixed sensor.

    Intervals are a bootstrap over seeds; against `fixed` seeds are paired.
    """
    rng = np.random.default_rng(0)
    seeds = len(outcomes) if fixed is None else min(len(outcomes), len(fixed))
    draw = np.vstack([np.arange(seeds), rng.integers(seeds, size=(_RESAMPLES, seeds))])
    out: dict[str, Any] = {"seeds": seeds, "converged": float(np.mean(outcomes[:, 4]))}
    for column, name in enumerate(COLUMNS[:2]):
        ours = _rms(outcomes[draw, column])
        out[name] = interval(ours)
        if name == "position":
            out["position_cm"] = interval(100.0 * ours)
        if fixed is not None:
            out[f"{name}_change"] = interval(100.0 * (ours / _rms(fixed[draw, column]) - 1.0))
    for column, name in enumerate(COLUMNS[2:4], start=2):
        out[name] = interval(np.mean(outcomes[draw, column], axis=1))
    return out


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=1))


def interval(values: Array) -> dict[str, float]:
    """The first value (the whole sample's), and the central 95 % of the others, resampled."""
    low, high = np.quantile(values[1:], [0.025, 0.975])
    return {"value": float(values[0]), "low": float(low), "high": float(high)}
