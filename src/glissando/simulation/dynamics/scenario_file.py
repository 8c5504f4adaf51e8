"""Scenarios of moving robots from TOML files and from actuations."""

from __future__ import annotations

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.table import Table
from glissando.simulation.actuation import Actuation
from glissando.simulation.dynamics.base_motion import BaseMotion
from glissando.simulation.dynamics.scenario import HalfSpace, Hold, Scenario, TimedWrench
from glissando.simulation.rod import Wrench

_EVER = float("inf")
_FARTHEST = 10.0  # m: largest motion of a base or a tendon; more indicates another unit


def scenario_of(actuation: Actuation) -> Scenario:
    """Scenario with the tensions and loads of an actuation, at its times."""
    return Scenario(
        tensions=lambda time: np.asarray(actuation.loads_at(time).tensions),
        gravity=actuation.gravity,
        wrenches=tuple(TimedWrench(wrench) for wrench in actuation.wrenches),
        jumps=tuple(actuation.time.tolist()),
    )


def read_scenario(
    table: Table, tendons: int, gravity: Array, base: Array
) -> tuple[Scenario, float]:
    """Read the scenario of a file, and its last time, s.

    Keys are tensions, or displacements with tendon_stiffness, and their time; gravity; [[loads]],
    [[half_spaces]] and [[holds]], each with `from` and `until`; and [base].

    Args:
        table: The file.
        tendons: Number of tendons.
        gravity: Default gravity (3,) if the file has none, m/s².
        base: Initial pose (4, 4) of the base.

    Raises:
        SimulationError: A key is missing, misspelt or impossible.
    """
    by_displacement = table.peek("displacements") is not None
    key = "displacements" if by_displacement else "tensions"
    rows = table.matrix(key, tendons)
    if not by_displacement and np.any(rows < 0.0):
        raise table.fail("tensions", f"is {rows.tolist()}; a tendon only pulls, give N ≥ 0.")
    if by_displacement and np.abs(rows).max() > _FARTHEST:
        raise table.fail("displacements", f"is {rows.tolist()}; give metres.")
    time = _times(table, len(rows))
    stiffness = table.vector("tendon_stiffness", tendons, positive=True) if by_displacement else ()
    actuation = Actuation(time, rows, table.vector("gravity", 3, gravity))

    def pull(moment: float) -> Array:
        return np.asarray(actuation.loads_at(moment).tensions)

    wrenches = [_load(entry) for entry in table.tables("loads")]
    half_spaces = [_half_space(entry) for entry in table.tables("half_spaces")]
    holds = [_hold(entry) for entry in table.tables("holds")]
    motion = _base(table, base)
    table.close()
    scenario = Scenario(
        tensions=() if by_displacement else pull,
        displacements=pull if by_displacement else None,
        tendon_stiffness=stiffness,
        gravity=actuation.gravity,
        wrenches=tuple(wrenches),
        half_spaces=tuple(half_spaces),
        holds=tuple(holds),
        base=motion,
        jumps=tuple(time.tolist()),
    )
    events = scenario.events
    return scenario, float(events[-1]) if events.size else 0.0


def _times(table: Table, count: int) -> Array:
    if count == 1 and table.peek("time") is None:
        return np.zeros(1)
    time = table.vector("time", count, pairs=False)
    if np.any(np.diff(time) <= 0.0):
        raise table.fail("time", f"is {time.tolist()}; give times that increase.")
    return time


def _window(table: Table) -> dict[str, float]:
    start = table.number("from", 0.0, positive=False)
    stop = table.number("until", 1e9, positive=False)
    if stop < start:
        raise table.fail("until", f"is {stop:g} s, before from = {start:g} s; give a later time.")
    table.close()
    return {"start": start, "stop": _EVER if stop == 1e9 else stop}


def _load(table: Table) -> TimedWrench:
    force, moment = (table.vector(key, 3, np.zeros(3)) for key in ("force", "moment"))
    wrench = Wrench(table.number("arclength"), force, moment)
    return TimedWrench(wrench, **_window(table))


def _half_space(table: Table) -> HalfSpace:
    point, normal = table.vector("point", 3), table.vector("normal", 3)
    stiffness = table.number("stiffness")
    damping, friction = (table.number(key, 0.0, positive=False) for key in ("damping", "friction"))
    return HalfSpace(point, normal, stiffness, damping, friction, **_window(table))


def _hold(table: Table) -> Hold:
    place = table.vector("place", 3) if table.peek("place") is not None else None
    arclength, stiffness = table.number("arclength"), table.number("stiffness")
    damping = table.number("damping", 0.0, positive=False)
    return Hold(arclength, stiffness, damping, place, **_window(table))


def _base(table: Table, base: Array) -> BaseMotion | None:
    """Read [base]: time, positions (m) and rotation vectors (rad) from `base`, in world axes."""
    entry = table.table("base")
    if entry is None:
        return None
    time = entry.numbers("time")
    zero = np.zeros((time.size, 3))
    stated = [entry.peek(key) is not None for key in ("positions", "rotations")]
    shift = entry.matrix("positions", 3) if stated[0] else zero
    turn = entry.matrix("rotations", 3) if stated[1] else zero
    entry.close()
    if len(shift) != time.size or len(turn) != time.size:
        raise entry.fail(
            "time", f"has {time.size} times; give a row of positions or rotations each."
        )
    if np.any(np.diff(time) <= 0.0):
        raise entry.fail("time", f"is {time.tolist()}; give times that increase.")
    if np.abs(shift).max() > _FARTHEST:
        raise entry.fail("positions", f"is {shift.tolist()}; give metres.")
    if np.abs(turn).max() > 2.0 * np.pi:
        raise entry.fail("rotations", f"is {turn.tolist()}; give radians, a turn at most.")
    pose = np.tile(base, (time.size, 1, 1))
    pose[:, :3, :3] = se3.so3_exp(turn) @ base[:3, :3]
    pose[:, :3, 3] += shift
    return BaseMotion(time, pose)
