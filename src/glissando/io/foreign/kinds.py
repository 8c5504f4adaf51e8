"""Import of foreign files, whose format is recognised by name and content."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from glissando.errors import RecordingError
from glissando.io.foreign.c3d import read_c3d
from glissando.io.foreign.columns import parse_mapping, read_columns
from glissando.io.foreign.delimited import cells_of
from glissando.io.foreign.ndi_csv import is_ndi_header, read_ndi_csv
from glissando.io.foreign.optitrack_csv import is_motive_header, read_motive_csv
from glissando.io.foreign.qualisys_tsv import is_qualisys_header, read_qualisys_tsv
from glissando.io.foreign.rosbag import read_bag
from glissando.io.foreign.servo_csv import is_servo_header, servo_tracks
from glissando.io.foreign.tracks import Track, require_no_rate
from glissando.io.foreign.vicon_csv import TITLES, read_vicon_csv

_KNOWN = (
    "CSV of Vicon Tracker or Nexus, NDI Track or ToolBox, OptiTrack Motive; TSV of Qualisys; "
    "CSV of servos with a tip; .tum, c3d, ROS 1 .bag, folder of a ROS 2 bag"
)
_TUM = "time=1,x=2,y=3,z=4,qx=5,qy=6,qz=7,qw=8"


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1 bag, or the folder of a ROS 2 bag."""
    return path.suffix == ".bag" or (path / "metadata.yaml").exists()


def read_tracks(
    path: str | Path,
    *,
    rate: float | None = None,
    topics: Sequence[str] = (),
    columns: str = "",
) -> list[Track]:
    """Read the tracks of a foreign file.

    Args:
        path: File, or folder of a ROS 2 bag.
        rate: Frames a second, for formats that do not state them; None for those that state times.
        topics: Topics of a bag; by default all with poses.
        columns: Mapping of the columns of any other text, see `glissando.io.foreign.columns`.

    Raises:
        RecordingError: The file's format is unknown, or its content is invalid.
    """
    path = Path(path)
    if rate is not None and not 0.0 < rate < 1e6:
        raise RecordingError(f"A rate of {rate:g} Hz cannot be; give frames a second.")
    if columns and path.is_file():
        return read_columns(path, parse_mapping(columns, path.stem), rate)
    if is_bag(path):
        require_no_rate(path, rate)
        return read_bag(path, topics)
    if not path.is_file():
        raise RecordingError(f"There is no file {str(path)!r} to import; known are {_KNOWN}.")
    if path.suffix in (".db3", ".mcap"):
        raise RecordingError(
            f"{path} may be part of a ROS 2 bag: give the folder that it is in. A log of "
            f"`glissando record` is opened by every command through its folder."
        )
    with path.open("rb") as file:
        begins = file.read(2)
    if path.suffix.lower() == ".c3d" or begins == b"\x02\x50":
        return read_c3d(path, rate)
    cells = next((cells for _, cells in cells_of(path) if cells), [""])
    if path.suffix.lower() == ".tum":
        return read_columns(path, parse_mapping(_TUM, path.stem), rate)
    if cells[0] in TITLES:
        return read_vicon_csv(path, rate)
    if is_ndi_header(cells):
        return read_ndi_csv(path, rate)
    if is_motive_header(cells):
        return read_motive_csv(path, rate)
    if is_qualisys_header(cells):
        return read_qualisys_tsv(path, rate)
    if is_servo_header(cells):
        require_no_rate(path, rate)
        return servo_tracks(path)
    if cells[:2] == ["time", "arclength"]:
        raise RecordingError(f"{path} is a recording's stream already; name it in recording.toml.")
    raise RecordingError(
        f"{path} is of no known kind (it begins with {','.join(cells)[:40]!r}); known are {_KNOWN}."
        f" For any other text say what its columns hold with --columns."
    )
