"""A session log becomes a recording in the same folder."""

from __future__ import annotations

from pathlib import Path

from glissando.hardware.capture.setup import Rig
from glissando.io.atomic_folder import renewed_folder
from glissando.io.recording_writer import write_streams
from glissando.io.session_log import RawSession
from glissando.io.session_recording import session_streams


def write_recording(session: RawSession, rig: Rig, folder: Path) -> list[str]:
    """Write the streams of a session as a recording.

    Args:
        session: The log.
        rig: The rig it was logged with.
        folder: Where the recording goes.

    Returns:
        Sentences on bodies that were never seen, and on gaps.

    Raises:
        RecordingError: Nothing is left.
    """
    recorded = session_streams(session, rig.described())
    with renewed_folder(folder, ()) as building:
        frames = {"tracker": recorded.frame}
        write_streams(
            building, recorded.name, recorded.streams, robot=recorded.robot, frames=frames
        )
    return recorded.warnings
