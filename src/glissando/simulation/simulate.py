"""Simulation of a session in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from glissando.errors import SimulationError
from glissando.io.shipped_robots import robot_file
from glissando.model.field_checks import is_number
from glissando.model.slide_path import SlidePath, read_slide
from glissando.model.tendons.channel import Channel
from glissando.simulation.bench import Bench, load_bench
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.motion import Motion
from glissando.simulation.simulated_session import Session, simulate_session

_HOLD = 15.0  # s: default duration of the slide hold

_OPTIONS = {
    "hold": ("at",),
    "oscillate": ("cycles", "stroke", "speed"),
    "traverse": ("cycles", "stroke", "speed"),
}
"""Options of each named slide; a file has none."""


class _FromFile(Protocol):
    """Object read from a robot file, such as a Robot."""

    @property
    def file(self) -> Path | None:
        """Path of the file, or None."""


def simulate(
    robot: str | Path | _FromFile = "sliding700",
    *,
    shape: str = "S",
    slide: str | SlidePath = "oscillate",
    seed: int = 0,
    duration: float | None = None,
    without: Sequence[str] = (),
    dynamic: bool = False,
    name: str = "simulated",
    tendons: bool = False,
    channel: Channel | None = None,
    **options: float,
) -> Session:
    """Simulate the recording of a robot with a sliding coil, with ground truth.

    Args:
        robot: Name of a shipped robot, path of a robot file with [physics], or a robot that
            `load_robot` read from such a file.
        shape: Name of one of the robot's shapes (straight, C, S, C-to-S), or a TOML file.
        slide: hold, oscillate, traverse (a stage as long as the robot), a CSV file, or a SlidePath.
        seed: Seed of all noise, ≥ 0.
        duration: Duration, s; by default until robot and slide are at rest.
        without: Imperfections to switch off; "all" for all of them.
        dynamic: Whether the robot has inertia; otherwise the motion is quasi-static.
        name: Name of the session.
        tendons: Whether displacements of the tendons are also recorded.
        channel: Channel beside the backbone in which the coil slides; None for the backbone.
        options: Options of the slide: `at` (m, of hold), `cycles`, `stroke` (m), `speed` (m/s).

    Raises:
        SimulationError: An argument is impossible.
        NoShapeError: The rod has no static shape under the loads.

    >>> session = simulate(slide="hold", duration=0.5, without=["all"])
    >>> len(session.coil.time)
    21
    """
    bench = _bench_of(robot)
    _require_numbers(seed, duration)
    flaws = bench.flaws.without(*((without,) if isinstance(without, str) else without))
    path = slide_path(bench, slide, duration, options)
    motion: Motion | DynamicMotion
    if dynamic:
        scenario, last = bench.scenario(shape)
        seconds = duration or max(path.duration, last)
        motion = bench.move_dynamically(scenario, flaws, seed, seconds)
    else:
        motion = bench.move(bench.shape(shape), flaws, seed)
    return simulate_session(
        bench, motion, path, seed=seed, duration=duration, flaws=flaws, name=name,
        tendons=tendons, channel=channel,
    )  # fmt: skip


def _bench_of(robot: str | Path | _FromFile) -> Bench:
    """Bench of a robot given by its name, its file, or an object read from the file."""
    file = robot if isinstance(robot, str | Path) else getattr(robot, "file", None)
    if not isinstance(file, str | Path):
        raise SimulationError(
            f"The robot is {robot!r}; give its name, or the robot file, which has [physics]."
        )
    return load_bench(robot_file(file))


def _require_numbers(seed: int, duration: float | None) -> None:
    """Raise SimulationError if the seed or the duration is not a suitable number."""
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise SimulationError(f"Seed {seed!r} cannot be; give a whole number from 0 up.")
    if not (duration is None or is_number(duration) or duration != duration):
        raise SimulationError(f"A duration of {duration!r} cannot be; give seconds.")


def slide_path(
    bench: Bench, slide: str | SlidePath, duration: float | None, options: dict[str, float]
) -> SlidePath:
    """Path of a named slide or of a file, within the limits of its stage.

    Args:
        bench: The robot with its stages.
        slide: hold, oscillate, traverse, a CSV file, or a SlidePath, which is returned.
        duration: Duration of hold, s.
        options: Options of the slide, see `simulate`.

    Raises:
        SimulationError: There is no such slide, or it does not have an option.
    """
    stage = bench.slide
    if isinstance(slide, SlidePath):
        return slide
    if slide not in _OPTIONS and not Path(slide).is_file():
        raise SimulationError(
            f"There is no slide named {slide!r} and no such file; give hold, oscillate, "
            f"traverse or a CSV file."
        )
    for option in options:
        if option not in _OPTIONS.get(slide, ()):
            raise SimulationError(
                f"{option} says nothing to the slide {slide}; leave it out or choose another slide."
            )
    if slide == "hold":
        return SlidePath.hold(options.get("at", 0.0), duration or _HOLD, stage)
    if slide not in _OPTIONS:
        return read_slide(Path(slide), stage, bench.rod.length + bench.coil_offset)
    stage, default_cycles = (bench.full_slide, 1) if slide == "traverse" else (stage, 3)
    cycles = options.get("cycles", default_cycles)
    if cycles != int(cycles):
        raise SimulationError(f"{cycles:g} cycles cannot be; give a whole number.")
    return SlidePath.oscillate(
        int(cycles),
        options.get("stroke", stage.stroke),
        stage,
        speed=options.get("speed"),
    )
