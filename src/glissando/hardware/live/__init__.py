"""Live estimation: sources of readings, sinks of updates, and the session between them."""

from glissando.hardware.live.igtl_sink import IgtlSink
from glissando.hardware.live.igtl_source import IgtlSource
from glissando.hardware.live.placement import Placement
from glissando.hardware.live.session import LiveSession
from glissando.hardware.live.sinks import CsvSink, Sink
from glissando.hardware.live.sources import RecordingSource, Source
from glissando.hardware.live.update import Update

__all__ = [
    "CsvSink", "IgtlSink", "IgtlSource", "LiveSession", "Placement", "RecordingSource", "Sink",
    "Source", "Update",
]  # fmt: skip
