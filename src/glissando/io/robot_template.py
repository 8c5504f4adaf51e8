"""Robot files for robots of which little is known: a broad prior from a few physical numbers."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from glissando.errors import RobotFileError
from glissando.io.plain_file import file_stem
from glissando.io.provenance import stated_format
from glissando.model.sensors.sensors import sensor_class, sensor_kinds

_JUMPS = """\
# How differently segments bend. Where they often bend as far as they can in directions of their own
# and only the tip is read, give four times as much: else half of them are inside 95 % there."""

_LIKELY = {  # smallest and largest plausible value, and their unit
    "length": (0.02, 10.0, "m"),
    "diameter": (2e-4, 0.2, "m"),
    "bend": (math.radians(5.0), 4.0 * math.pi, "rad"),
    "stretch": (1e-4, 1.0, "of the length"),
    "time_scale": (0.02, 60.0, "s"),
}
_NOISE = {  # standard deviations of common devices, broad
    "pose": "[1.5e-3, 0.015]",
    "coil": "[1.5e-3, 0.015]",
    "position": "[1.5e-3, 1.5e-3, 1.5e-3]",
    "orientation": "[0.015, 0.015, 0.015]",
    "gyro": "[0.1, 0.1, 1.0]",
    "strain": "[0.01, 0.01, 0.01, 0.3, 0.3, 0.3]",
    "fbg": "[2e-5]",
}


@dataclass(frozen=True)
class RobotOutline:
    """Known properties of a robot before anything was learned from recordings.

    Attributes:
        name: Name of the robot.
        length: Length, m.
        segments: Number of segments of equal length, each actuated independently.
        diameter: Outer diameter of the discs or of the body, m.
        bend: Largest bend of one segment, rad.
        stretch: Largest extension or slip of discs along the backbone, as a share of the length.
        time_scale: Time, s, in which the shape can change completely.
        sensors: Kinds of sensor, or KIND:STREAM for a stream of a recording.
    """

    name: str
    length: float
    segments: int
    diameter: float
    bend: float
    sensors: Sequence[str]
    stretch: float = 0.05
    time_scale: float = 0.5

    def __post_init__(self) -> None:
        for key, (low, high, unit) in _LIKELY.items():
            value = getattr(self, key)
            if not low <= value <= high:
                raise RobotFileError(
                    f"A robot's {key.replace('_', ' ')} of {_quantity(value, unit)} is not likely; "
                    f"give {_quantity(low, unit)} to {_quantity(high, unit)}."
                )
        if self.diameter > self.length:
            raise RobotFileError(
                f"A robot {self.length:g} m long cannot be {self.diameter:g} m across; give both "
                f"in metres."
            )
        if not 1 <= self.segments <= 20:
            raise RobotFileError(f"{self.segments} segments are not likely; give 1 to 20.")
        for kind, _ in self.streams:
            if kind not in _NOISE:
                known = ", ".join(k for k in sensor_kinds() if k in _NOISE)
                what = "is not a kind of sensor"
                if kind in sensor_kinds():
                    what = "needs mechanics, which a new file lacks"
                raise RobotFileError(f"{kind!r} {what}; known: {known}.")
        _require_streams([stream for _, stream in self.streams])

    @property
    def streams(self) -> list[tuple[str, str]]:
        """Kinds of the sensors and names of their streams, empty where none is given."""
        parts = (sensor.partition(":") for sensor in self.sensors)
        return [(kind, stream) for kind, _, stream in parts]


def _quantity(value: float, unit: str) -> str:
    """A number with its unit; an angle also in degrees."""
    degrees = f" ({math.degrees(value):.3g} degrees)" if unit == "rad" else ""
    return f"{value:.4g} {unit}{degrees}"


def _require_streams(streams: Sequence[str]) -> None:
    """Raise RobotFileError if there is no sensor, or if two sensors have the same stream."""
    if not streams:
        raise RobotFileError("A robot without sensors cannot be estimated; give one or more.")
    named = [file_stem(stream, RobotFileError) for stream in streams if stream]
    if repeated := [name for name, count in Counter(named).items() if count > 1]:
        raise RobotFileError(f"Two sensors are the stream {repeated[0]!r}; give each stream once.")


def robot_text(outline: RobotOutline) -> str:
    """Text of a robot file with a broad prior, with comments that give reasons.

    For the curvature at the base, and for its jump between segments, the largest bend of a segment
    is two standard deviations; within a segment the curvature varies by three tenths of that. A
    broad prior costs little accuracy near sensors, and keeps covariances consistent elsewhere.

    Args:
        outline: Known properties of the robot.
    """
    segment_length = outline.length / outline.segments
    var_u = (outline.bend / (2.0 * segment_length)) ** 2
    psd_u, var_nu = var_u / (12.0 * segment_length), (0.5 * outline.stretch) ** 2
    joints = [round(segment_length * i, 9) for i in range(1, outline.segments)]
    row = f"[1e-7, 1e-7, {var_nu / 40:.2g}, {psd_u:.3g}, {psd_u:.3g}, {psd_u / 15:.3g}]"
    jump = f"[1e-9, 1e-9, {4 * var_nu:.2g}, {var_u:.3g}, {var_u:.3g}, {var_u / 25:.2g}]"
    rows = row
    if joints:
        rows = f"[{', '.join([row] * outline.segments)}]"
        rows += f"\n{_JUMPS}\nvar_jumps = [{', '.join([jump] * len(joints))}]"
    return _TEXT.format(
        format=stated_format("robot"),
        name=_quoted(outline.name),
        length=outline.length,
        nodes=max(5, 2 * outline.segments + 1),
        rate=round(15.0 / outline.time_scale, 3),
        off=f"{(0.2 * outline.diameter + 1e-3) ** 2:.2g}",
        clamped=20.0 * outline.time_scale,
        bend=math.degrees(outline.bend),
        strain=f"[1e-7, 1e-7, {var_nu:.2g}, {var_u:.3g}, {var_u:.3g}, {var_u / 25:.2g}]",
        stretch=100.0 * outline.stretch,
        scale=outline.time_scale,
        joints=f"joints = {joints}\n" if joints else "",
        rows=rows,
        sensors=_sensors(outline),
        parameters=_parameters(outline),
    )


def _sensors(outline: RobotOutline) -> str:
    """Tables of the sensors' noise, one for each kind."""
    out = []
    for kind in dict.fromkeys(kind for kind, _ in outline.streams):
        robust = "" if sensor_class(kind).rows == 1 else 'loss = "huber"\n'
        out.append(f"[sensors.{kind}]\nstd = {_NOISE[kind]}\n{robust}")
    return "\n".join(out)


def _parameters(outline: RobotOutline) -> str:
    """Entries of unknown sensor parameters by stream: delay, and a tracker's mount and drift."""
    std_position = 0.1 * outline.diameter + 1e-3
    out = [_REPEATED if any(stream for _, stream in outline.streams) else _UNNAMED]
    for kind, stream in outline.streams:
        if not stream:
            continue
        pieces = [("delay", "time_offset", "0.02", "")]
        if sensor_class(kind).tracker:
            correlation = "correlation_time = 1.0\n"
            pieces = [("mount", "mount", f"{std_position:.2g}, 0.03", "")]
            pieces.append(("drift", "mount", "3e-3, 0.03", correlation))
        for what, parameter, std, more in pieces:
            name = _quoted(f"{stream} {what}")
            out.append(_PARAMETER.format(name, parameter, _quoted(stream), std, more))
    return "\n".join(out)


def _quoted(text: str) -> str:
    """A text quoted for TOML."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


_REPEATED = "# What is constant but unknown of each sensor: every reading repeats it."
_UNNAMED = """\
# Sensors without a stream's name count as mounted where they are said to be. Where one is a
# little off, every reading repeats it, and confidence near it is false: give KIND:STREAM then."""
_PARAMETER = """\
[[sensor_parameters]]
name = {}
kind = "{}"
streams = [{}]
std = [{}]
{}"""

_TEXT = """\
# Written by `glissando robot new`: broad numbers, nothing learned. Densities and variances are of
# strain, [shear x, shear y, extension, bending x, bending y, torsion], in SI units and radians.
# `glissando learn` makes them sharper, `glissando check` says whether confidence is true.
format = "{format}"
name = {name}
length = {length}
rest_strain = [0, 0, 1, 0, 0, 0]  # straight; at rest as it is unloaded

[grid]
arclength_nodes = {nodes}
time_rate = {rate}                # time nodes a second, fifteen to a time scale; where `glissando
                                  # estimate` warns of the grid, the rate that it names

[base]                            # clamped where it is, but registered only so well
position = [0, 0, 0]
quaternion = [1, 0, 0, 0]
var_pose = [{off}, 4e-4]
time_scale = {clamped}            # s: what is off stays off
# The first segment bends by {bend:.0f} degrees at most, taken as two standard deviations, and
# each further one may bend by as much more or less than the one before it; what is mounted on the
# body slips, or the body stretches, by {stretch:.3g} % of its length.
var_strain = {strain}

[prior]
kind = "separable"
time_scale = {scale}              # s in which the shape can change altogether
{joints}psd_strain_arclength = {rows}

{sensors}
{parameters}"""
