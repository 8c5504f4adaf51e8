"""Sources and sinks constructed from the addresses given on a command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from glissando.errors import GlissandoError
from glissando.hardware.live.igtl_sink import IgtlSink
from glissando.hardware.live.igtl_source import IgtlSource
from glissando.hardware.live.placement import Placement
from glissando.hardware.live.sinks import CsvSink, Sink
from glissando.hardware.live.sources import RecordingSource, Source
from glissando.hardware.ros2.ros2_sink import Ros2Sink
from glissando.hardware.ros2.ros2_source import Ros2Source
from glissando.model.robot import Robot

SOURCES = "igtl://HOST:PORT, igtl-server://:PORT, ros2, or the folder of a recording"
SINKS = "igtl-server://:PORT, igtl://HOST:PORT, ros2, or csv:FILE"


def source_of(text: str, robot: Robot, placements: Sequence[Placement] = ()) -> Source:
    """Construct the source at an address.

    Args:
        text: Address, in a form that `SOURCES` lists.
        robot: The robot.
        placements: Positions on the robot of devices that a peer identifies by name.

    Raises:
        GlissandoError: The address has none of these forms.
    """
    require_source(text)
    if text.startswith("igtl"):
        return IgtlSource(text, robot, placements)
    if text.partition("?")[0] == "ros2":
        return Ros2Source(text, robot, placements)
    return RecordingSource(text, robot)


def require_source(text: str) -> None:
    """Raise GlissandoError unless a text has a form that `SOURCES` lists."""
    named = text.startswith("igtl") or text.partition("?")[0] == "ros2" or Path(text).is_dir()
    if not named:
        raise GlissandoError(f"There is no source {text!r}; give {SOURCES}.")


def sink_of(text: str) -> Sink:
    """Construct the sink at an address, in a form that `SINKS` lists. Raises GlissandoError."""
    if text.startswith("igtl"):
        return IgtlSink(text)
    if text.partition("?")[0] == "ros2":
        return Ros2Sink(text)
    if text.startswith("csv:") and text != "csv:":
        return CsvSink(Path(text.removeprefix("csv:")))
    raise GlissandoError(f"There is no sink {text!r}; give {SINKS}.")
