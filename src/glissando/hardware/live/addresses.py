"""Sources and sinks by the texts that name them on a command line."""

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
    """The source that a text names.

    Args:
        text: One of `SOURCES`.
        robot: The robot.
        placements: Where devices sit that report themselves by name.

    Raises:
        GlissandoError: It names none.
    """
    require_source(text)
    if text.startswith("igtl"):
        return IgtlSource(text, robot, placements)
    if text.partition("?")[0] == "ros2":
        return Ros2Source(text, robot, placements)
    return RecordingSource(text, robot)


def require_source(text: str) -> None:
    """Raise GlissandoError unless a text names a source, one of `SOURCES`."""
    named = text.startswith("igtl") or text.partition("?")[0] == "ros2" or Path(text).is_dir()
    if not named:
        raise GlissandoError(f"There is no source {text!r}; give {SOURCES}.")


def sink_of(text: str) -> Sink:
    """The sink that a text names, one of `SINKS`. Raises GlissandoError."""
    if text.startswith("igtl"):
        return IgtlSink(text)
    if text.partition("?")[0] == "ros2":
        return Ros2Sink(text)
    if text.startswith("csv:") and text != "csv:":
        return CsvSink(Path(text.removeprefix("csv:")))
    raise GlissandoError(f"There is no sink {text!r}; give {SINKS}.")
