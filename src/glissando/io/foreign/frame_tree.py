"""Frames that hang from others, as ROS publishes them on /tf: their poses in the frame at the root.

A transform says where a child frame is in its parent; one that holds at all times is static.
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
    """What is known of the frames of a bag.

    Attributes:
        static: Parent of each frame that is fixed in it, and its pose (4, 4) there.
        moving: Poses of each frame that moves, as a track in the frame of its parent.
    """

    static: Mapping[str, tuple[str, Array]]
    moving: Mapping[str, Track]

    def at_root(self, frame: str) -> Track:
        """A moving frame's track in the frame at the root of its tree.

        Times at which a frame on the way was not seen yet, or not any more, are left out as those
        at which an object was missing.

        Raises:
            RecordingError: The frames go round in a circle.
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
        """The root of a frame, and the frame's poses (M, 4, 4) in it at times (M,); NaN unseen."""
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
    """Poses (M, 4, 4) of a track at times (M,), straight between its own; NaN beyond them."""
    out = np.full((time.size, 4, 4), np.nan)
    if track.time.size < 2:
        out[np.isin(time, track.time)] = track.values
        return out
    on = (track.time[0] <= time) & (time <= track.time[-1])
    turn = Slerp(track.time, Rotation.from_matrix(track.values[:, :3, :3]))(time[on])
    place = [np.interp(time[on], track.time, column) for column in track.values[:, :3, 3].T]
    out[on] = se3.pose(turn.as_matrix(), np.stack(place, axis=-1))
    return out
