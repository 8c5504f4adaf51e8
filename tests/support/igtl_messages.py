"""Random OpenIGTLink messages of every type that is read."""

import numpy as np

from glissando.geometry import se3
from glissando.hardware.openigtlink import Message
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.polydata import Attribute, PolyData


def rounded(numbers) -> np.ndarray:
    """Numbers that float32 holds exactly."""
    return np.asarray(numbers).astype(np.float32).astype(float)


def random_pose(rng) -> np.ndarray:
    pose = se3.exp(rng.normal(size=6))
    pose[:3, 3] *= 100.0
    return rounded(pose)


def random_contents(rng) -> list:
    count = int(rng.integers(0, 5))
    numbers = rounded(rng.normal(size=3))
    tools = [c.Tool(f"tool {k}", int(rng.integers(1, 5)), random_pose(rng)) for k in range(count)]
    points = [c.Point(f"p{k}", rounded(rng.normal(size=3)), 0.5, "g") for k in range(count)]
    return [
        c.Transform(random_pose(rng)),
        c.Position(numbers),
        c.Position(numbers, rounded(rng.normal(size=4))),
        c.TrackingData(tuple(tools)),
        c.Points(tuple(points)),
        c.Status(int(rng.integers(0, 20)), "wider than 3 µm", "NAME", int(rng.integers(-9, 9))),
        c.Text("µm", 106),
        c.Text("plain"),
        c.SensorValues(rng.normal(size=count), int(rng.integers(0, 1 << 40)), 3),
        c.NumberArray(rng.normal(size=tuple(rng.integers(0, 4, size=int(rng.integers(1, 4)))))),
        c.NumberArray(rng.integers(0, 9, size=(2, 3)).astype("u2")),
        c.StartTracking(20, "tracker"),
        random_mesh(rng),
    ]


def random_mesh(rng) -> PolyData:
    points = rounded(rng.normal(size=(int(rng.integers(3, 9)), 3)))
    count = len(points)
    cells = [rng.integers(0, count, size=int(rng.integers(1, 5))) for _ in range(4)]
    attributes = (
        Attribute("sigma", rounded(rng.normal(size=(count, 1)))),
        Attribute("normal", rounded(rng.normal(size=(count, 3))), 2),
    )
    return PolyData(points, (cells[0],), (cells[1], cells[2]), (cells[3],), (), attributes)


def random_messages(rng) -> list[Message]:
    out = []
    for content in random_contents(rng):
        stamp = int(rng.integers(0, 1 << 62))
        out.append(Message(content, "device", stamp))
        out.append(Message(content, "µ-device", stamp, 2, 7, {"key": "value", "µ": "µs"}))
    return out
