"""Files of other programs: import of motion capture, trackers and bags; export of trajectories."""

from glissando.io.foreign.kinds import read_tracks
from glissando.io.foreign.recording import Choices, write_recording
from glissando.io.foreign.tracks import Track
from glissando.io.foreign.trajectories import export

__all__ = ["Choices", "Track", "export", "read_tracks", "write_recording"]
