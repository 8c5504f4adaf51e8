"""Updates as OpenIGTLink messages, which 3D Slicer, PLUS and MATLAB's toolboxes display.

| device | type | |
|---|---|---|
| Robot | TDATA | all frames in one message, tools of six degrees of freedom named by arclength |
| Tip | TRANSFORM | pose of the last frame |
| Centreline | POLYDATA | a polyline with the attribute `sigma` |
| Tube95 | POLYDATA | the surface that contains the robot with 95 % probability, with `sigma` |
| Ellipsoids95 | POLYDATA | an ellipsoid of 95 % probability about each frame |
| Points | POINT | ten times a second: latest measured sensor positions, and forces |
| Estimate | STATUS, STRING | once a second: state of the estimator, and figures as JSON |
| (stream) | NDARRAY | readings in double precision, for another instance of glissando |

`sigma` is the square root of the total position variance in the unit of length of the connection.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.spatial import ConvexHull

from glissando.estimation.confidence_tube import confidence_tube, tube_faces
from glissando.geometry.se3 import Array
from glissando.hardware.live.update import Update
from glissando.hardware.openigtlink import EndpointUser, Message, encode
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.polydata import Attribute, PolyData
from glissando.io.csv_stream import Rows
from glissando.model.grid import Index
from glissando.model.sensors.readings import Readings

_RING_POINTS = 12  # points of a ring of the tube
_LONG = 1 << 16  # bytes of a message
_STATUS_PERIOD, _POINTS_PERIOD = 1.0, 0.1  # s between statuses, and between points


class IgtlSink(EndpointUser):
    """Sends updates to every peer of an endpoint.

    Args:
        address: Address as `Endpoint` takes it; its option `send=` selects what is sent.

    Attributes:
        counts: Events of the connection by name, and updates of streams that were 'not sent'
            because their mount, channel or settings cannot be transmitted.

    Raises:
        DeviceError: The address is invalid.
    """

    def __init__(self, address: str) -> None:
        super().__init__(address, hears=False)
        self.name = address.partition("?")[0]
        self._send = self._endpoint.address.send
        self._last_status = self._last_points = -np.inf
        self._measured: dict[str, Array] = {}

    def __enter__(self) -> Self:
        super().__enter__()
        crc64(bytes(_LONG))  # its tables are made now, and not during the first update
        return self

    @property
    def problem(self) -> str:
        """Reason why no peer receives updates; always empty where the sink listens for peers."""
        calling = not self._endpoint.address.listens and not self._endpoint.peers
        return f"nobody answers at {self.name}" if calling else ""

    def poll(self) -> None:
        """Process new and closed connections, and incoming messages."""
        self._endpoint.receive()

    def send(self, update: Update) -> None:
        """Pass an update to the process that communicates with the peers."""
        for readings in update.readings:
            if readings.values.shape[1:] == (4, 4):
                self._measured[readings.label] = readings.values[-1, :3, 3]
        if self._endpoint.peers:
            stamp = update.stamp
            self._endpoint.send(
                [
                    encode(Message(content, device, stamp))
                    for device, content in self._contents(update)
                ]
                + self._readings(update)
            )

    def _contents(self, update: Update) -> Iterator[tuple[str, c.Content]]:
        send, sigma = self._send, update.state.std_position / self._frame.scale
        poses = self._frame.poses_out(update.state.pose)
        if "frames" in send:
            named = zip(update.arclength, poses, strict=True)
            tools = (c.Tool(frame_name(s), c.TOOL_6D, pose) for s, pose in named)
            yield "Robot", c.TrackingData(tuple(tools))
        if "tip" in send:
            yield "Tip", c.Transform(poses[-1])
        if "line" in send:
            line = (np.arange(len(poses)),)
            yield "Centreline", PolyData(poses[:, :3, 3], lines=line, attributes=_sigma(sigma))
        cov = update.state.position_covariance()
        if "tube" in send:
            rings, of = confidence_tube(update.state.pose, cov, around=_RING_POINTS)
            yield "Tube95", self._mesh(rings, tube_faces(*rings.shape[:2]), sigma[of])
        if "ellipsoids" in send:
            shells = _SIGMAS * _SPHERE @ np.linalg.cholesky(_definite(cov)).swapaxes(-1, -2)
            shells = shells @ update.state.pose[:, :3, :3].swapaxes(-1, -2)
            shells += update.state.position[:, None]
            first = len(_SPHERE) * np.arange(len(shells))
            faces = (_SPHERE_FACES + first[:, None, None]).reshape(-1, 3)
            yield "Ellipsoids95", self._mesh(shells, faces, sigma)
        if "points" in send and update.time - self._last_points >= _POINTS_PERIOD - 1e-6:
            self._last_points = update.time
            yield "Points", c.Points(tuple(self._points(update)))
        if "status" in send and update.time - self._last_status >= _STATUS_PERIOD:
            self._last_status = update.time
            yield "Estimate", _status(update)
            yield "Estimate", c.Text(json.dumps(_figures(update)))

    def _points(self, update: Update) -> Iterator[c.Point]:
        """Latest sensor positions, named by stream, and loads, named by their magnitude."""
        for label, place in self._measured.items():
            yield c.Point(within(label, 64), self._frame.points_out(place), group="sensors")
        if (loads := update.loads()) is not None:
            size = np.linalg.norm(loads.wrench.force, axis=-1)
            for place, force, std in zip(loads.position, size, loads.std_force, strict=True):
                text = f"{force:.3g} ± {std:.2g} N"
                yield c.Point(text, self._frame.points_out(place), group="loads")

    def _mesh(self, groups: Array, faces: Index, sigma: Array) -> PolyData:
        """Mesh of G groups (G, A, 3) of points that each have one sigma (G,)."""
        each = np.repeat(sigma, groups.shape[1])
        points = self._frame.points_out(groups.reshape(-1, 3))
        return PolyData(points, polygons=faces, attributes=_sigma(each))

    def _readings(self, update: Update) -> list[bytes]:
        if "readings" not in self._send:
            return []
        at, out = (update.stamp, update.time), []
        for readings in filter(lambda r: r.kind, update.readings):
            if _is_representable(readings):
                out.append(encode(readings_message(readings, *at)))
            else:
                self._own_counts[f"{readings.label} not sent (mount, channel or settings)"] += 1
        return out


@lru_cache(maxsize=4096)
def frame_name(arclength: float) -> str:
    """Name of the frame at an arclength in m.

    >>> frame_name(0.2335)
    's233.5mm'
    """
    return f"s{1e3 * arclength:.1f}mm"


def readings_message(readings: Readings, stamp: int, time: float | None = None) -> Message:
    """Readings as one NDARRAY of float64 in SI units: time, arclength, and the kind's columns.

    The metadata hold the stream's full name, its kind and the time of the stamp in seconds.

    Args:
        readings: Readings of one stream.
        stamp: Stamp of the message.
        time: Time of the stamp, s, on the clock of the readings; if None, the receiver assumes that
            the stamp is the time of the last reading.
    """
    metadata = {"kind": readings.kind, "name": readings.label}
    if time is not None:
        metadata["time"] = repr(float(time))
    rows = Rows(readings.kind, readings.time, readings.arclength, readings.values, {})
    table = c.NumberArray(rows.table())
    return Message(table, within(readings.label, 20), stamp, 2, metadata=metadata)


def _is_representable(readings: Readings) -> bool:
    """Whether a table of time, arclength and values represents readings completely."""
    placed = readings.channel is not None or np.any(readings.mount != np.eye(4))
    return not (placed or readings.settings)


def within(text: str, size: int) -> str:
    """Longest beginning of a text that fits into a field of `size` bytes in UTF-8."""
    return text.encode()[:size].decode(errors="ignore")


def _sigma(sigma: Array) -> tuple[Attribute, ...]:
    return (Attribute("sigma", sigma[:, None]),)


def _status(update: Update) -> c.Status:
    """Status code 1 for normal operation, 10 for a poor fit, 13 with the update's problems."""
    if update.problems:
        return c.Status(13, "; ".join(update.problems), "SILENT")
    if not update.smoother.fits:
        return c.Status(10, "Innovations are larger than the model allows.", "DOES_NOT_FIT")
    return c.Status(1, "", "")


def _figures(update: Update) -> dict[str, object]:
    loads = update.loads()
    wrenches = {} if loads is None else {
        "loads": [
            {"arclength": place, "wrench": wrench, "std": std}
            for place, wrench, std in zip(
                loads.arclength.tolist(), loads.wrench.wrench.tolist(), loads.wrench.std.tolist(),
                strict=True,
            )
        ]
    }  # fmt: skip
    return {
        **wrenches,
        "time": update.time,
        "tip_sigma_m": update.std_tip,
        "latency_s": update.latency,
        "nis": update.smoother.nis,
        "dropped": {name: dict(why) for name, why in update.smoother.dropped.items()},
        "skipped": update.skipped,
    }


def _definite(cov: Array) -> Array:
    """Covariances (…, 3, 3) with a small diagonal term that ensures a Cholesky factor."""
    least = 1e-12 * np.einsum("...ii->...", cov) + 1e-24
    return cov + least[..., None, None] * np.eye(3)


def _unit_sphere() -> tuple[Array, Index]:
    """Eighteen points on the unit sphere, and triangles between them with outward normals."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), -1).reshape(-1, 3)
    corners = grid[np.isin(np.abs(grid).sum(axis=1), (1.0, 2.0))]
    points = corners / np.linalg.norm(corners, axis=1)[:, None]
    hull = ConvexHull(points)
    faces = hull.simplices
    outward = np.einsum("fi,fi->f", hull.equations[:, :3], np.cross(
        points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    ))  # fmt: skip
    return points, np.where(outward[:, None] > 0.0, faces, faces[:, ::-1])


_SPHERE, _SPHERE_FACES = _unit_sphere()
_SIGMAS = 3.164962  # to the vertices of a polyhedron that contains 95 % of a Gaussian
