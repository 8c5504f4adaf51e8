"""A [physics] table for a robot of which little is known, so that it can be simulated."""

from __future__ import annotations

import math

from glissando.errors import RobotFileError
from glissando.io.robot_template import RobotOutline

_YOUNG, _DENSITY = 60e9, 6450.0  # Pa and kg/m³, of nitinol
_TENDON, _BORE = 5.0 / 12.0, 0.9  # of the robot's diameter, of a tube's outer diameter
_SLENDER = 300.0  # typical ratio of the robot's length to the diameter of its backbone
_BENT = math.radians(150.0)  # largest bend of the whole robot in its shapes, rad
_FOUR = [(1, 0), (0, 1), (-1, 0), (0, -1)]  # directions of a segment's tendons


def physics_text(outline: RobotOutline) -> str:
    """Text of a [physics] table: a hanging nitinol robot with four tendons a segment.

    The backbone has a typical thickness for the robot's length and diameter. The tensions of the
    shapes bend a segment by half of its largest bend, or the whole robot by 150 degrees if that is
    less.

    Args:
        outline: Known properties of the robot.

    Raises:
        RobotFileError: The robot has no coil, the sensor that slides in a simulation.
    """
    if not any(kind == "coil" for kind, _ in outline.streams):
        raise RobotFileError(
            "A simulated session is read by a coil that slides; give coil among the sensors too."
        )
    length, count, diameter = outline.length, outline.segments, outline.diameter
    outer = min(0.5 * diameter, max(diameter / 6.0, length / _SLENDER))
    tubes = [(outer, _BORE * outer), (0.6 * outer, 0.4 * outer)]
    stiffness = _YOUNG * math.pi / 64.0 * sum(a**4 - b**4 for a, b in tubes)
    radius, segment_length = _TENDON * diameter, length / count
    tension = min(0.5 * outline.bend, _BENT / count) * stiffness / (radius * segment_length)
    tendons = [
        f"[[physics.tendons]]\noffset = [{x * radius:.4g}, {y * radius:.4g}]\nend = {end}\n"
        f"friction = 0.15\n"
        for end in _shares(length, count)
        for x, y in _FOUR
    ]
    return _TEXT.format(
        young=_YOUNG,
        density=_DENSITY,
        disk=0.5 * diameter,
        disks=round(200.0 * diameter**2, 9),
        inertial=_shares(length, 2),
        truth=_shares(length, 6),
        tubes=", ".join(f"{{ outer = {a:.4g}, inner = {b:.4g} }}" for a, b in tubes),
        tendons="\n".join(tendons),
        stroke=min(0.06, 0.2 * length),
        length=length,
        middle=0.5 * length,
        shapes=_shapes(count, tension),
    )


def _shares(length: float, count: int) -> list[float]:
    """End points, m, of `count` equal parts of a length; the last is the length itself."""
    return [round(length * i / count, 9) for i in range(1, count)] + [length]


def _shapes(segments: int, tension: float) -> str:
    """Tables of named shapes: tensions, N, of the tendons, of which each segment has four."""
    straight, bent, twice = ([0.0] * 4 * segments for _ in range(3))
    bent[-4] = twice[-4] = float(f"{tension:.3g}")
    shapes = [f"straight]\ntensions = {straight}", f"C]\ntensions = {bent}"]
    motion, initial = f"straight-to-C]\ntime = [0, 20]\ntensions = [{straight}, {bent}]", straight
    if segments > 1:  # the opposite tendon of the lower half bends it the other way
        twice[4 * (segments // 2) - 2] = 2.0 * bent[-4]
        shapes.append(f"S]\ntensions = {twice}")
        initial = bent
        motion = f"C-to-S]\ntime = [0, 20]\ntensions = [{initial}, {twice}]"
    return "\n\n".join(f"[physics.shapes.{shape}" for shape in [*shapes, motion])


_TEXT = """
# For `glissando simulate` alone; what is estimated does not use it.
[physics]
gravity = [0, 0, 9.81]            # along the robot: it hangs
young = {young:g}
poisson = 0.33
density = {density:g}
disk_radius = {disk:g}
disk_mass_per_length = {disks:g}  # kg/m
retardation = 0.02                # s, of the material's damping
air_damping = 2e-3                # N s/m²
inertial_arclengths = {inertial}
truth_arclengths = {truth}
tubes = [{tubes}]                 # nitinol: the backbone and the tube that slides in it

{tendons}
[physics.slide]
stroke = {stroke!r}
speed = 0.024
acceleration = 0.1
coil_offset = 0

[physics.full_slide]              # a stage as long as the robot
stroke = {length!r}
speed = 0.1
acceleration = 0.2

[physics.tracker]
position = [0.35, 0.3, {middle:g}]
quaternion = [0.7071067811865476, 0.7071067811865476, 0, 0]

{shapes}
"""
