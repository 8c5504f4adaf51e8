"""Scenes of a robot with inertia and a coil on a drive tube, with slides of different speed.

A pass is a slide over the length of the robot while the robot moves from one shape to another.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from pathlib import Path

from glissando.experiments.scenes import ROBOT, Scene, bench
from glissando.io.atomic import write_text
from glissando.io.shipped_robots import robot_file

SHAPE = "C-to-S"
_DURATION = 4.0  # s
_SPEEDS = {"slow": 0.05, "once": 0.2, "often": 1.0}  # m/s: 0.3, 1.1 and 5.7 passes
_TUBE = """\
drive_stiffness = 400.0
drive_friction = 0.2
exposure = 0.025
"""
_DELAY = """
[[sensor_parameters]]
name = "{kind}"
kind = "{kind}"
streams = ["coil"]
value = [{value}]
"""
_LAGS = {"time_offset": 0.0125, "slide_lag": 0.01375}  # s: half an exposure; lag of the coil


def driven_robot(folder: Path) -> Path:
    """Write the paper's robot with a drive tube and a tracker with exposure; returns its file.

    The tube is elastic and has friction. The estimator knows the lags of tube and tracker as sensor
    parameters, which replace the mount and drift of the file, as those hold for a slow slide.
    """
    head = "[physics.imperfections]"
    text = robot_file(ROBOT).read_text(encoding="utf-8")
    stated, physics = text.index("[[sensor_parameters]]"), text.index("[physics]")
    before, after = (text[:stated] + text[physics:]).split(head)
    delays = "".join(_DELAY.format(kind=kind, value=value) for kind, value in _LAGS.items())
    file = folder / "robot.toml"
    write_text(file, f"{before}{head}\n{_TUBE}{after}{delays}")
    return file


def passes_arms(robot: Path) -> dict[str, Scene]:
    """Scenes of a fixed coil, and of slides of less than one, one and several passes."""
    scene = Scene(SHAPE, "hold", _DURATION, robot=str(robot), dynamic=True, paced=True)
    length = bench().rod.length
    arms = {"fixed": scene}
    for name, speed in _SPEEDS.items():
        cycles = max(1, ceil(_DURATION * speed / (2.0 * length)))
        arms[name] = replace(scene, slide="traverse", speed=speed, stroke=length, cycles=cycles)
    return arms
