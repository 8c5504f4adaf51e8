"""Frames of /tf become tracks in the frame at the root, whatever hangs between."""

import numpy as np
import pytest
from hypothesis import given
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from draws import generators, law, poses, sixes
from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.io.foreign.frame_tree import FrameTree
from glissando.io.foreign.kinds import read_tracks
from glissando.io.foreign.tracks import Track

BEGIN = 1778067471  # s


@law
@given(generators)
def test_a_frame_is_where_the_product_of_all_on_the_way_puts_it(rng):
    """Frames that move turn at a constant rate, so that they are known between their stamps."""
    bed, mount = poses(rng, 2, largest_angle=3.0)
    start, rate = poses(rng), np.concatenate([np.zeros(3), sixes(rng, reach=0.3)[3:]])

    def arm(t):
        return start @ se3.exp(t[:, None] * rate)

    knots, time = np.sort(rng.uniform(0.0, 3.0, 8)), np.sort(rng.uniform(0.0, 3.0, 20))
    own = poses(rng, 20, largest_angle=3.0)
    tree = FrameTree(
        {"bed": ("world", bed), "mount": ("arm", mount)},
        {"arm": Track("arm", "pose", knots, arm(knots), 0, "bed"),
         "tip": Track("tip", "pose", time, own, 1, "mount")},
    )  # fmt: skip
    found, on = tree.at_root("tip"), (knots[0] <= time) & (time <= knots[-1])
    assert found.frame == "world"
    assert found.missing == 1 + np.sum(~on)
    np.testing.assert_array_equal(found.time, time[on])
    np.testing.assert_allclose(found.values, (bed @ arm(time) @ mount @ own)[on], atol=1e-9)


def test_frames_in_a_circle_are_one_sentence():
    still = np.eye(4)
    track = Track("tip", "pose", np.zeros(1), still[None], 0, "a")
    tree = FrameTree({"a": ("b", still), "b": ("a", still)}, {"tip": track})
    with pytest.raises(RecordingError, match="circle, tip → a → b → a"):
        tree.at_root("tip")


def test_a_bag_of_tf_becomes_a_track_for_each_frame_that_moves(tmp_path):
    store, rng, kind = (
        get_typestore(Stores.ROS2_HUMBLE),
        np.random.default_rng(0),
        "tf2_msgs/msg/TFMessage",
    )
    types = {name.rpartition("/")[2]: each for name, each in store.types.items()}
    fixed, moves = poses(rng), poses(rng, 2, 5)

    def transform(parent, child, pose, at):
        stamp = types["Time"](BEGIN, at)
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        inner = types["Transform"](types["Vector3"](*pose[:3, 3]), types["Quaternion"](x, y, z, w))
        return types["TransformStamped"](types["Header"](stamp, parent), child, inner)

    with Writer(tmp_path / "run", version=9) as out:
        held, tf = (out.add_connection(t, kind, typestore=store) for t in ("/tf_static", "/tf"))
        whole = types["TFMessage"]([transform("map", "tracker", fixed, 0)])
        out.write(held, 1, store.serialize_cdr(whole, kind))
        for k in range(5):
            parts = [transform("tracker", f"coil{c}", moves[c, k], k) for c in range(2)]
            out.write(tf, 2 + k, store.serialize_cdr(types["TFMessage"](parts), kind))
    tracks = read_tracks(tmp_path / "run")
    assert [track.name for track in tracks] == ["tf_coil0", "tf_coil1"]
    for track, own in zip(tracks, moves, strict=True):
        assert track.frame == "world"
        np.testing.assert_allclose(track.values, fixed @ own, atol=1e-9)
        np.testing.assert_allclose(track.time, BEGIN + 1e-9 * np.arange(5), atol=1e-6)
