"""Files of other programs that are no text: bags of ROS and c3d of motion capture."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from draws import poses


def bag(path, version, rng, storage=StoragePlugin.SQLITE3):
    """A bag of a PoseStamped, a TransformStamped and a text topic; poses and stamps in ns."""
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    more = {"seq": 0} if version == 1 else {}
    stamps = 1778067471_000000000 + np.cumsum(rng.integers(1, 10**8, 5))
    track = poses(rng, 5, largest_angle=np.pi)
    encode = store.serialize_ros1 if version == 1 else store.serialize_cdr
    made = Bag1(path) if version == 1 else Bag2(path, version=9, storage_plugin=storage)
    with made as out:
        kinds = {"/vicon/tip": "PoseStamped", "/vicon/mid": "TransformStamped"}
        for topic, kind in kinds.items():
            kind = f"geometry_msgs/msg/{kind}"
            connection = out.add_connection(topic, kind, typestore=store)
            for at, pose in zip(stamps.tolist(), track, strict=True):
                time = types["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9)
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="aurora", **more)
                x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
                turn = types["geometry_msgs/msg/Quaternion"](x, y, z, w)
                if topic.endswith("tip"):
                    place = types["geometry_msgs/msg/Point"](*pose[:3, 3])
                    inner = types["geometry_msgs/msg/Pose"](place, turn)
                    message = types[kind](header, inner)
                else:
                    place = types["geometry_msgs/msg/Vector3"](*pose[:3, 3])
                    inner = types["geometry_msgs/msg/Transform"](place, turn)
                    message = types[kind](header, "mid", inner)
                for late in (10**6, 2 * 10**6):  # each stamp comes twice
                    out.write(connection, at + late, encode(message, kind))
        talk = out.add_connection("/talk", "std_msgs/msg/String", typestore=store)
        message = types["std_msgs/msg/String"]("hello")
        out.write(talk, int(stamps[0]), encode(message, "std_msgs/msg/String"))
    return track, stamps


def c3d(path, unit="mm"):
    """A c3d of two points, each missing once; their positions (2, 20, 3) in metres."""
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d, which writes c3d, is not installed")
    points = np.random.default_rng(0).uniform(-1, 1, (2, 20, 3))
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [120.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["tip", "mid one"]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    written = np.ones((4, 2, 20))
    written[:3] = np.moveaxis(points, 2, 0) / {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[unit]
    residual = np.zeros((1, 2, 20))
    residual[0, 0, 4], written[:3, 1, 6] = -1.0, np.nan
    file["data"]["points"], file["data"]["meta_points"]["residuals"] = written, residual
    file.write(str(path))
    return points
