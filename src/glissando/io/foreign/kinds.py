"""Foreign files of every kind, told apart by name and content."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from glissando.errors import RecordingError
from glissando.io.foreign.c3d import read_c3d
from glissando.io.foreign.ndi_csv import is_ndi_header, read_ndi_csv
from glissando.io.foreign.rosbag import read_bag
from glissando.io.foreign.tracks import Track, text_lines
from glissando.io.foreign.vicon_csv import TITLES, read_vicon_csv

_KNOWN = (
    "CSV of Vicon Tracker or Nexus, CSV of NDI Track or ToolBox, c3d, ROS 1 .bag, folder of a "
    "ROS 2 bag"
)


def read_tracks(
    path: str | Path, *, rate: float | None = None, topics: Sequence[str] = ()
) -> list[Track]:
    """Tracks of a foreign file.

    Args:
        path: File, or folder of a ROS 2 bag.
        rate: Frames a second, for kinds that do not state them.
        topics: Topics of a bag; by default all with poses.

    Raises:
        RecordingError: The file is of no known kind, or something in it is wrong.
    """
    path = Path(path)
    if rate is not None and not 0.0 < rate < 1e6:
        raise RecordingError(f"A rate of {rate:g} Hz cannot be; give frames a second.")
    if path.suffix == ".bag" or (path / "metadata.yaml").exists():
        return read_bag(path, topics)
    if not path.is_file():
        raise RecordingError(f"There is no file {str(path)!r} to import; known are {_KNOWN}.")
    if path.suffix in (".db3", ".mcap"):
        raise RecordingError(f"{path} may be part of a ROS 2 bag; give the folder that it is in.")
    with path.open("rb") as file:
        begins = file.read(2)
    if path.suffix.lower() == ".c3d" or begins == b"\x02\x50":
        return read_c3d(path, rate)
    first = next(iter(text_lines(path)), "")
    if first.split(",")[0].strip() in TITLES:
        return read_vicon_csv(path, rate)
    if is_ndi_header(first):
        return read_ndi_csv(path, rate)
    if first.startswith("time,arclength"):
        raise RecordingError(f"{path} is a recording's stream already; name it in recording.toml.")
    raise RecordingError(
        f"{path} is of no known kind (it begins with {first[:40]!r}); known are {_KNOWN}."
    )
