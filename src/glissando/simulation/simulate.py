"""A session of a simulated robot in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from glissando.errors import SimulationError
from glissando.io.shipped_robots import robot_file
from glissando.model.slide_path import SlidePath, read_slide
from glissando.model.tendons.channel import Channel
from glissando.simulation.bench import Bench, load_bench
from glissando.simulation.dynamics.motion import DynamicMotion
from glissando.simulation.motion import Motion
from glissando.simulation.simulated_session import Session, simulate_session

_HOLD = 15.0  # s that a slide holds still unless told how long

_OPTIONS = {
    "hold": ("at",),
    "oscillate": ("cycles", "stroke", "speed"),
    "traverse": ("cycles", "stroke", "speed"),
}
"""Options that each named slide takes; a file takes none."""


def simulate(
    robot: str | Path = "sliding700",
    *,
    shape: str = "S",
    slide: str = "oscillate",
    seed: int = 0,
    duration: float | None = None,
    without: Sequence[str] = (),
    dynamic: bool = False,
    name: str = "simulated",
    tendons: bool = False,
    channel: Channel | None = None,
    **options: float,
) -> Session:
    """What the sensors of a robot with a sliding coil record, and what truly happened.

    Args:
        robot: Name of a shipped robot, or path of a robot file with [physics].
        shape: Name of one of its shapes (straight, C, S, C-to-S), or a TOML file.
        slide: hold, oscillate, traverse (a stage as long as the robot), or a CSV file.
        seed: Seed of all noise, from 0 up.
        duration: Seconds; until robot and slide stand still unless given.
        without: Imperfections to switch off, "all" for every one.
        dynamic: Whether the robot has inertia; else it is at rest at every instant.
        name: Name of the session.
        tendons: Whether displacements of the tendons are recorded, too.
        channel: The channel beside the backbone that the coil slides in; on the backbone unless
            given.
        options: Of the slide: `at` (m, of hold), `cycles`, `stroke` (m), `speed` (m/s).

    Raises:
        SimulationError: What is asked for cannot be.
        NoShapeError: The physics has no static shape there.

    >>> session = simulate(slide="hold", duration=0.5, without=["all"])
    >>> len(session.coil.time)
    21
    """
    bench = load_bench(robot_file(robot))
    if seed < 0:
        raise SimulationError(f"Seed {seed} cannot be; give a whole number from 0 up.")
    flaws = bench.flaws.without(*without)
    path = slide_path(bench, slide, duration, options)
    motion: Motion | DynamicMotion
    if dynamic:
        scenario, last = bench.scenario(shape)
        lasts = duration or max(path.duration, last)
        motion = bench.move_dynamically(scenario, flaws, seed, lasts)
    else:
        motion = bench.move(bench.shape(shape), flaws, seed)
    return simulate_session(
        bench,
        motion,
        path,
        seed=seed,
        duration=duration,
        flaws=flaws,
        name=name,
        tendons=tendons,
        channel=channel,
    )


def slide_path(
    bench: Bench, slide: str, duration: float | None, options: dict[str, float]
) -> SlidePath:
    """The path of a named slide, or of a file, on the stage that it needs.

    Args:
        bench: The robot with its stages.
        slide: hold, oscillate, traverse, or a CSV file.
        duration: Seconds that hold lasts.
        options: As those of `simulate`.

    Raises:
        SimulationError: There is no such slide, or it does not take an option.
    """
    stage = bench.slide
    if slide not in _OPTIONS and not Path(slide).is_file():
        raise SimulationError(
            f"There is no slide named {slide!r} and no such file; give hold, oscillate, "
            f"traverse or a CSV file."
        )
    for option in options:
        if option not in _OPTIONS.get(slide, ()):
            raise SimulationError(
                f"--{option} says nothing to --slide {slide}; leave it out or choose another slide."
            )
    if slide == "hold":
        return SlidePath.hold(options.get("at", 0.0), duration or _HOLD, stage)
    if slide not in _OPTIONS:
        return read_slide(Path(slide), stage, bench.rod.length + bench.coil_offset)
    stage, usual = (bench.full_slide, 1) if slide == "traverse" else (stage, 3)
    return SlidePath.oscillate(
        int(options.get("cycles", usual)),
        options.get("stroke", stage.stroke),
        stage,
        speed=options.get("speed"),
    )
