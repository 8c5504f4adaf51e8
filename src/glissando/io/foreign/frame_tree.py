"""Trees of frames, as ROS publishes them on /tf, and poses of frames in the root of their tree.

A transform is the pose of a child frame in its parent; a static one holds at all times.
Source: Foote, *tf: The transform library* (2013).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import Track


@dataclass(frozen=True)
class FrameTree:
    """Transforms between the frames of a bag.

    Attributes:
        static: Parent and pose (4, 4) in the parent of each static frame, by the frame's name.
        moving: Track of each moving frame in the frame of its parent, by the frame's name.
    """

    static: Mapping[str, tuple[str, Array]]
    moving: Mapping[str, Track]

    def at_root(self, frame: str) -> Track:
        """Track of a moving frame in the root frame of its tree.

        Times outside the track of a frame between it and the root are left out and counted as
        missing.

        Raises:
            RecordingError: The frames form a cycle.
        """
        track = self.moving[frame]
        root, pose = self._from_root(track.frame, track.time, (frame,))
        seen = np.isfinite(pose[:, 0, 0])
        return replace(
            track,
            frame=root,
            time=track.time[seen],
            values=pose[seen] @ track.values[seen],
            missing=track.missing + int(np.sum(~seen)),
        )

    def _from_root(self, frame: str, time: Array, below: tuple[str, ...]) -> tuple[str, Array]:
        """Root of a frame, and the frame's poses (M, 4, 4) in it at times (M,); NaN if unknown."""
        if frame in below:
            way = " → ".join((*below, frame))
            raise RecordingError(f"Frames hang from each other in a circle, {way}; mend the bag.")
        if frame in self.static:
            parent, fixed = self.static[frame]
            root, pose = self._from_root(parent, time, (*below, frame))
            return root, pose @ fixed
        if frame in self.moving:
            track = self.moving[frame]
            root, pose = self._from_root(track.frame, time, (*below, frame))
            return root, pose @ _between(track, time)
        return frame, np.tile(np.eye(4), (time.size, 1, 1))


def _between(track: Track, time: Array) -> Array:
    """Poses (M, 4, 4) of a track at times (M,), interpolated linearly; NaN outside its times."""
    out = np.full((time.size, 4, 4), np.nan)
    if track.time.size < 2:
        out[np.isin(time, track.time)] = track.values
        return out
    on = (track.time[0] <= time) & (time <= track.time[-1])
    rotation = Slerp(track.time, Rotation.from_matrix(track.values[:, :3, :3]))(time[on])
    position = [np.interp(time[on], track.time, column) for column in track.values[:, :3, 3].T]
    out[on] = se3.pose(rotation.as_matrix(), np.stack(position, axis=-1))
    return out
