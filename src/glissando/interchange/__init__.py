"""Other people's files, in and out: motion capture, trackers and bags in; trajectories out."""

from glissando.interchange.kinds import read_tracks
from glissando.interchange.recording import Choices, write_recording
from glissando.interchange.tracks import Track
from glissando.interchange.trajectories import export

__all__ = ["Choices", "Track", "export", "read_tracks", "write_recording"]
