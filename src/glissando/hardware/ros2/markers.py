"""Markers of an update for RViz and Foxglove.

| namespace | marker | |
|---|---|---|
| centreline | LINE_STRIP | |
| tube95 | TRIANGLE_LIST | the surface that contains the robot with 95 % probability |
| ellipsoids95 | SPHERE | an ellipsoid of 95 % probability about each frame |
| measured | ARROW | the z axis of each coil and body, as last measured |
| forces | ARROW | estimated forces at the points where the prior has loads |
| forces95 | SPHERE | an ellipsoid of 95 % probability about the tip of each such arrow |
"""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube, tube_faces
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.live.update import Loads, Update

_AROUND = 8  # points of a ring of the tube
_ARROW = 0.06  # length of a measured axis, as a fraction of the robot's length
_WIDTH = 0.004  # width of a line, as a fraction of the robot's length
Color = tuple[float, float, float]
"""Red, green and blue, from 0 to 1."""
_BODY, _MEASURED, _FORCE = (0.35, 0.55, 0.75), (0.85, 0.45, 0.1), (0.8, 0.15, 0.2)


class MarkerBuilder:
    """Constructs markers of updates, and messages of poses and points.

    Args:
        geometry: The module geometry_msgs.msg.
        visualization: The module visualization_msgs.msg.
    """

    def __init__(self, geometry: Any, visualization: Any) -> None:
        self._geometry, self._visualization = geometry, visualization
        self._measured: dict[str, Array] = {}

    def note(self, update: Update) -> None:
        """Store the latest measured poses of an update."""
        for readings in update.readings:
            if readings.values.shape[1:] == (4, 4):
                self._measured[readings.label] = readings.values[-1]

    def pose(self, pose: Array) -> Any:
        """Pose message of a pose (4, 4)."""
        out = self._geometry.Pose()
        out.position.x, out.position.y, out.position.z = pose[:3, 3].tolist()
        w, x, y, z = se3.quaternion(pose[:3, :3]).tolist()
        out.orientation.w, out.orientation.x = w, x
        out.orientation.y, out.orientation.z = y, z
        return out

    def array(
        self, update: Update, loads: Loads | None, header: Any, metres_per_newton: float
    ) -> Any:
        """All markers of an update.

        Args:
            update: The update.
            loads: Estimated loads; None if the prior has none.
            header: Header of every marker.
            metres_per_newton: Length of a force's arrow per newton, m.
        """
        markers = [self._line(update), self._tube(update)]
        cov = update.state.position_covariance()
        for k, (pose, each) in enumerate(zip(update.state.pose, cov, strict=True)):
            markers.append(self._ball("ellipsoids95", k, _BODY, pose, each))
        width = _WIDTH * float(update.arclength[-1])
        for k, pose in enumerate(self._measured.values()):
            axis = _ARROW * update.arclength[-1] * pose[:3, 2]
            markers.append(self._arrow("measured", k, _MEASURED, width, pose[:3, 3], axis))
        markers += [] if loads is None else self._forces(loads, width, metres_per_newton)
        for marker in markers:
            marker.header = header
        return self._visualization.MarkerArray(markers=markers)

    def _forces(self, loads: Loads, width: float, scale: float) -> list[Any]:
        out = []
        for k, (place, force) in enumerate(zip(loads.position, loads.wrench.force, strict=True)):
            out.append(self._arrow("forces", k, _FORCE, width, place, scale * force))
            end, spread = np.eye(4), scale**2 * loads.wrench.cov[k, :3, :3]
            end[:3, 3] = place + scale * force
            out.append(self._ball("forces95", k, _FORCE, end, spread))
        return out

    def _line(self, update: Update) -> Any:
        line = self._marker("centreline", 0, self._visualization.Marker.LINE_STRIP, _BODY)
        line.scale.x = _WIDTH * float(update.arclength[-1])
        line.points = self._points(update.state.position)
        return line

    def _tube(self, update: Update) -> Any:
        cov = update.state.position_covariance()
        rings, _ = confidence_tube(update.state.pose, cov, around=_AROUND)
        faces = tube_faces(*rings.shape[:2])
        tube = self._marker("tube95", 0, self._visualization.Marker.TRIANGLE_LIST, _BODY)
        tube.scale.x = tube.scale.y = tube.scale.z = 1.0
        tube.color.a, tube.points = 0.3, self._points(rings.reshape(-1, 3)[faces])
        return tube

    def _ball(self, space: str, number: int, rgb: Color, pose: Array, cov: Array) -> Any:
        """Ellipsoid of 95 % of a covariance (3, 3) in the axes of a pose."""
        ball = self._marker(space, number, self._visualization.Marker.SPHERE, rgb)
        variance, axes = np.linalg.eigh(cov)
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ axes * [np.sign(np.linalg.det(axes)), 1.0, 1.0]
        ball.pose = self.pose(turned)
        size = 2.0 * SIGMAS_95 * np.sqrt(np.maximum(variance, 1e-18))
        ball.scale.x, ball.scale.y, ball.scale.z = size.tolist()
        ball.color.a = 0.2
        return ball

    def _arrow(
        self,
        space: str,
        number: int,
        rgb: Color,
        width: float,
        place: Array,
        way: Array,
    ) -> Any:
        arrow = self._marker(space, number, self._visualization.Marker.ARROW, rgb)
        arrow.points = self._points(place + np.outer([0.0, 1.0], way))
        arrow.scale.x, arrow.scale.y = width, 2.0 * width
        return arrow

    def _marker(self, space: str, number: int, kind: int, rgb: Color) -> Any:
        marker = self._visualization.Marker(ns=space, id=number, type=kind)
        marker.pose.orientation.w = 1.0
        marker.color.r, marker.color.g, marker.color.b = rgb
        marker.color.a = 1.0
        return marker

    def _points(self, points: Array) -> list[Any]:
        point = self._geometry.Point
        return [point(x=x, y=y, z=z) for x, y, z in points.reshape(-1, 3).tolist()]
