"""Figures of plans, of sweeps of designs and of sensor placements, with lengths in millimetres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.design import NUMBERS, Design, pareto_front
from glissando.planning.placement import Placement
from glissando.planning.planning_problem import PlanningProblem
from glissando.planning.zones import Zone
from glissando.visualization.canvas import (
    MM,
    canvas,
    gif_frames,
    gif_rate,
    legend,
    legend_entries,
    line_colours,
)

_PLACES, _TIMES = 60, 81  # points of a map along the body and in time
_SLIDE_MOTION = 10.0  # s of a slide's motion that are drawn as its reach
_FRONT = {"std": "best set found", "bound": "no set goes below"}
_LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def plan_figure(
    problem: PlanningProblem,
    paths: Mapping[str, Array],
    zones: Sequence[Zone],
) -> Any:
    """Draw the predicted uncertainty over arclength and time for each path.

    The colour is the square root of the total position variance, mm; a white line is the path of
    the sensor, a dashed outline a zone.

    Args:
        problem: The planning problem.
        paths: Arclengths (T,) at the problem's `times` by name, m.
        zones: Zones of the objective.

    Returns:
        The axes (1, P), one for each path.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    place, time, maps = _maps(problem, paths)
    top = float(np.quantile(np.stack(list(maps.values())), 0.97))
    size = (4.6 * len(maps) + 0.8, 4.8)
    with canvas(*size) as figure:
        panels = figure.subplots(1, len(maps), sharey=True, squeeze=False)
        row = panels[0]
        for axes, (name, std) in zip(row, maps.items(), strict=True):
            style = {
                "vmin": 0.0,
                "vmax": top,
                "cmap": "viridis",
                "shading": "gouraud",
                "rasterized": True,
            }
            shade = axes.pcolormesh(time, place * MM, std, **style)
            axes.plot(problem.times, paths[name] * MM, color="white", lw=2.0)
            for zone in zones:
                _outline(axes, zone, problem)
            axes.set_title(name, loc="left", fontweight="bold")
            axes.set(xlabel="time (s)", xlim=time[[0, -1]], ylim=place[[0, -1]] * MM)
        row[0].set_ylabel("arclength (mm)")
        over: Any = "max"
        label = "position standard deviation (mm)"
        figure.colorbar(shade, ax=list(row), label=label, pad=0.015, extend=over)
    return panels


def _maps(
    problem: PlanningProblem, paths: Mapping[str, Array]
) -> tuple[Array, Array, dict[str, Array]]:
    """Arclengths (P,), times (T,), and predicted std of position (P, T) in mm by path."""
    nodes = problem.ahead.grid.arclength
    place = np.linspace(nodes[0], nodes[-1], _PLACES)
    time = np.linspace(problem.start, problem.end, _TIMES)
    where, when = (grid.ravel() for grid in np.meshgrid(place, time, indexing="ij"))
    maps = {}
    for name, path in paths.items():
        cov = problem.predict(path).cov_pose(where, when)
        std = MM * np.sqrt(np.einsum("zii->z", cov[:, :3, :3]))
        maps[name] = std.reshape(_PLACES, _TIMES)
    return place, time, maps


def save_plan_film(
    problem: PlanningProblem, paths: Mapping[str, Array], zones: Sequence[Zone], file: Path
) -> None:
    """Write a GIF of the predicted uncertainty along the body for each path.

    A triangle marks the sensor; zones that are active at the moment are shaded.

    Args:
        problem: The planning problem.
        paths: Arclengths (T,) at the problem's `times` by name, m.
        zones: Zones of the objective.
        file: The file to write.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    place, time, maps = _maps(problem, paths)
    top = float(np.quantile(np.stack(list(maps.values())), 0.97))
    with canvas(7.0, 4.2) as figure:
        axes: Any = figure.subplots()
        lasts = problem.end - problem.start
        rate = gif_rate(_TIMES / lasts)
        frames = np.linspace(0, time.size - 1, max(2, round(rate * lasts))).astype(int)
        with gif_frames(figure, file, rate, dpi=90) as writer:
            for k in frames.tolist():
                now = float(time[k])
                axes.clear()
                for zone in zones:
                    if zone.overlap(now, now):
                        low, high = (float(end[0]) for end in zone.ends(np.array([now])))
                        axes.axvspan(low * MM, high * MM, color="#E69F00", alpha=0.2, lw=0)
                for (name, std), colour in zip(maps.items(), line_colours(len(maps)), strict=True):
                    axes.plot(place * MM, std[:, k], color=colour, label=name)
                    at = float(np.interp(now, problem.times, paths[name]))
                    axes.plot(at * MM, 0.02 * top, "^", color=colour, clip_on=False)
                axes.set(xlim=place[[0, -1]] * MM, ylim=(0.0, top), xlabel="arclength (mm)")
                axes.set_ylabel("position standard deviation (mm)")
                axes.set_title(f"{now - problem.start:.1f} s", loc="left")
                axes.legend(loc="upper left", ncols=len(maps))
                writer.grab_frame()
                figure.set_layout_engine("none")  # all frames are laid out as the first


def _outline(axes: Any, zone: Zone, problem: PlanningProblem) -> None:
    overlap = zone.overlap(problem.start, problem.end)
    if overlap is None:
        return
    time = np.linspace(*overlap, 100)
    low, high = zone.ends(time)
    around = np.concatenate([low, high[::-1], low[:1]])
    style = {"color": "#E69F00", "lw": 1.6, "ls": "--"}
    axes.plot(np.concatenate([time, time[::-1], time[:1]]), around * MM, **style)


def design_figure(designs: Sequence[Design]) -> Any:
    """Draw the uncertainty of every design against each of its costs.

    A line joins the best designs at each cost; large marks are designs on the Pareto front.

    Args:
        designs: The designs.

    Returns:
        The axes (1, C), one for each cost.

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    best = pareto_front(designs)
    std = MM * np.array([d.std for d in designs])
    with canvas(3.6 * len(NUMBERS), 4.6) as figure:
        panels = figure.subplots(1, len(NUMBERS), sharey=True, squeeze=False)
        row = panels[0]
        for axes, (name, (unit, scale)) in zip(row, NUMBERS.items(), strict=True):
            cost = scale * np.array([float(getattr(d, name)) for d in designs])
            for zone, colour in enumerate(line_colours(std.shape[1])):
                axes.plot(cost, std[:, zone], "o", color=colour, ms=4, alpha=0.5)
                label = f"zone {zone + 1}, worth its cost"
                style = {"mfc": colour, "mec": "black", "ms": 7, "label": label}
                axes.plot(cost[best], std[best, zone], "o", **style)
                levels = np.unique(cost)
                floor = [std[cost == level, zone].min() for level in levels]
                axes.plot(levels, floor, color=colour, lw=1.2)
            axes.set_xlabel(f"{name} ({unit})" if unit else name)
            levels = np.unique(cost)
            if levels.size < 6:
                axes.set_xticks(levels, [f"{level:g}" for level in levels])
            if levels.size == 1:
                axes.set_xlim(0.0, 2.0 * levels[0] or 1.0)
        row[0].set_ylabel("position standard deviation (mm)")
        legend(figure, legend_entries(row[0]), loc="outside upper center", ncols=4)
    return panels


def placement_figure(placements: Sequence[Placement], length: float) -> Any:
    """Draw the uncertainty of sensor sets against their costs, and their positions on the body.

    Args:
        placements: Sensor sets, by increasing budget.
        length: Length of the body, m.

    Returns:
        The axes (1, 2).

    Raises:
        GlissandoError: matplotlib is not installed.
    """
    cost = np.array([each.cost for each in placements])
    kinds = list(dict.fromkeys(s.name.split()[0] for each in placements for s in each.chosen))
    with canvas(9.2, 4.2) as figure:
        panels = figure.subplots(1, 2, squeeze=False)
        front, body = panels[0]
        for name, marker in (("std", "o-"), ("bound", ":")):
            value = MM * np.array([getattr(each, name) for each in placements])
            front.plot(cost, value, marker, color=_LINES[0], label=_FRONT[name])
        front.set(xlabel="cost", ylabel="position standard deviation (mm)", yscale="log")
        front.legend(loc="upper right")
        for each in placements:
            for sensor in each.chosen:
                place = MM * sensor.places(np.linspace(0.0, _SLIDE_MOTION, _TIMES)).ravel()
                kind = kinds.index(sensor.name.split()[0])
                drawn = {"color": _LINES[kind % len(_LINES)], "label": kinds[kind]}
                body.plot(place, np.full(place.size, each.cost), "s", ms=4, **drawn)
        body.set(xlabel="arclength (mm)", ylabel="cost", xlim=(0.0, MM * length))
        entries = legend_entries(body)
        body.legend(entries.values(), entries.keys(), loc="lower right")
    return panels
