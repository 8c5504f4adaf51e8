"""Corrections of typical mistakes in poses, to be tried: units, orders, frames, axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array

Moved = tuple[Array, Array]
"""Arclengths (…) and poses (…, 4, 4) in the world."""


@dataclass(frozen=True)
class Correction:
    """A change of readings that undoes a mistake.

    Attributes:
        check: Name of the check for mistakes of this kind.
        cause: Probable mistake, as the end of a sentence.
        advice: Remedy, as the end of a sentence.
        change: Maps arclengths (…), poses (…, 4, 4) in the world and the frame's pose (4, 4) to
            corrected arclengths and poses.
        doubt: Factor on the cost of the correction's fit; 1 for the most likely corrections.
    """

    check: str
    cause: str
    advice: str
    change: Callable[[Array, Array, Array], Moved]
    doubt: float = 1.0


_UNITS = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "metres, read as millimetres": 1e3,
    "metres, read as centimetres": 1e2,
}
_LARGE, _SMALL = 3.0, 0.1  # sizes over the expected ones, beyond which other units are tried
_CYCLES = {"[x, y, z, w] where [w, x, y, z] is read": [3, 0, 1, 2],
           "[w, x, y, z] where [x, y, z, w] is meant": [1, 2, 3, 0]}  # fmt: skip


def corrections(
    length: float, reach: tuple[float, float], sizes: tuple[float, float], framed: bool
) -> list[Correction]:
    """Corrections to try on a stream, or on streams of one frame, the most likely first.

    Args:
        length: Length of the robot, m.
        reach: Least and largest arclength of the streams, m.
        sizes: Distance of the positions from the base over their arclength, and distance of the
            frame's origin from the world's over the robot's length.
        framed: Whether the streams have a frame other than the world.
    """
    return [
        *_units(sizes, framed),
        *_rotations(framed),
        *_mounts(),
        *_places(length, reach),
        *_axes(),
    ]


def _in_frame(change: Callable[[Array], Array]) -> Callable[[Array, Array, Array], Moved]:
    """Apply a change to the poses in the stream's frame, as in its file."""
    return lambda place, pose, frame: (place, frame @ change(se3.inverse(frame) @ pose))


def _of_frame(change: Callable[[Array], Array]) -> Callable[[Array, Array, Array], Moved]:
    """Apply a change to the pose of the stream's frame."""
    return lambda place, pose, frame: (place, change(frame) @ se3.inverse(frame) @ pose)


def _on_body(turn: Array) -> Callable[[Array, Array, Array], Moved]:
    """Rotate the poses in their body frame."""
    return lambda place, pose, frame: (place, pose @ turn)


def _along(factor: float, offset: float) -> Callable[[Array, Array, Array], Moved]:
    """Change arclengths to factor · s + offset."""
    return lambda place, pose, frame: (factor * place + offset, pose)


def _units(sizes: tuple[float, float], framed: bool) -> Iterator[Correction]:
    """Corrections of units, if positions or the frame are as large or small as the unit implies."""
    for unit, factor in _UNITS.items():
        if (sizes[0] < _LARGE) if factor < 1.0 else (sizes[0] > _SMALL):
            continue
        yield Correction(
            "length-unit",
            f"its positions are probably in {unit}",
            'give metres, or length_unit = "mm"',
            _in_frame(partial(scaled, factor=factor)),
        )
    for unit, factor in _UNITS.items():
        if framed and factor < 1.0 and sizes[1] > _LARGE:
            yield Correction(
                "frame",
                f"its frame's position is probably in {unit}",
                "give [frames] in metres",
                _of_frame(partial(scaled, factor=factor)),
            )


def _rotations(framed: bool) -> Iterator[Correction]:
    for order, index in _CYCLES.items():
        yield Correction(
            "quaternion",
            f"its quaternions are probably {order}",
            "give qw, qx, qy, qz",
            _in_frame(partial(reordered, index=index)),
        )
        if framed:
            yield Correction(
                "frame",
                f"its frame's quaternion is probably {order}",
                "give w, x, y, z in [frames]",
                _of_frame(partial(reordered, index=index)),
            )
    yield Correction(
        "quaternion",
        "its rotations are probably those from world to body",
        "give body to world (conjugate the quaternions)",
        _in_frame(_conjugated),
    )
    yield Correction(
        "frame",
        "its poses are probably inverted, the world as the sensor sees it",
        "give the pose of the sensor in the world",
        _in_frame(se3.inverse),
    )
    if framed:
        yield Correction(
            "frame",
            "its frame is probably inverted",
            "give the pose of the frame in the world",
            _of_frame(se3.inverse),
        )
        yield Correction(
            "frame",
            "its readings are probably in the world frame already",
            'leave out its "frame"',
            _of_frame(_identity),
        )
        yield Correction(
            "frame",
            "its frame's rotation is probably that from world to frame",
            "conjugate the quaternion in [frames]",
            _of_frame(_conjugated),
        )


def _mounts() -> Iterator[Correction]:
    for name, turn in {
        "x": [0.0, np.pi / 2, 0.0],
        "y": [-np.pi / 2, 0.0, 0.0],
        "−z": [np.pi, 0.0, 0.0],
        "−x": [0.0, -np.pi / 2, 0.0],
        "−y": [np.pi / 2, 0.0, 0.0],
    }.items():
        rotation = se3.pose(se3.so3_exp(np.array(turn)), np.zeros(3))
        yield Correction(
            "mount",
            f"its {name} axis, not z, probably runs along the robot",
            "give the sensor's [streams.mount]",
            _on_body(rotation),
        )


def _places(length: float, reach: tuple[float, float]) -> Iterator[Correction]:
    yield Correction(
        "slide",
        "its arclength is probably counted from the tip",
        "count it from the base",
        _along(-1.0, length),
    )
    if reach[1] - reach[0] > 1e-3:
        yield Correction(
            "slide",
            "its slide probably runs the other way",
            "change the sign of the slide's travel",
            _along(-1.0, reach[0] + reach[1]),
        )
    for factor in (0.1, 0.5, 2.0, 10.0, 1e2, 1e3):
        if factor * reach[1] <= 1.001 * length:
            yield Correction(
                "slide",
                f"its arclength is probably {1.0 / factor:g} times what it should be",
                "give metres along the robot",
                _along(factor, 0.0),
                1.5,
            )


def _axes() -> Iterator[Correction]:
    for matrix, shown in signed_axes():
        simple = abs(np.trace(matrix)) == 1.0  # one swap, or one sign
        yield Correction(
            "axes",
            f"its x, y, z are probably {shown} of the rotations' axes",
            "export positions and rotations in the same axes",
            _in_frame(partial(placed, matrix=matrix)),
            1.2 if simple else 1.5,
        )
        if np.linalg.det(matrix) > 0.0:
            yield Correction(
                "axes",
                f"its coordinates are probably turned: x, y, z for {shown}",
                "give the frame's rotation, or export with z up as the robot file has it",
                _in_frame(partial(turned, matrix=matrix)),
                1.3,
            )
        else:
            yield Correction(
                "axes",
                f"its coordinates are probably left-handed, {shown} for x, y, z",
                "export right-handed coordinates",
                _in_frame(partial(mirrored, matrix=matrix)),
                1.3 if simple else 1.6,
            )


def signed_axes() -> Iterator[tuple[Array, str]]:
    """Yield signed permutation matrices (3, 3) except the identity, with names of their axes."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        if order != (0, 1, 2) or min(signs) < 0.0:
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            shown = ("−" * (s < 0.0) + "xyz"[i] for i, s in zip(order, signs, strict=True))
            yield matrix, ", ".join(shown)


def scaled(pose: Array, factor: float) -> Array:
    """Poses with positions multiplied by a factor."""
    return se3.pose(pose[..., :3, :3], factor * pose[..., :3, 3])


def reordered(pose: Array, index: list[int]) -> Array:
    """Poses with the components of their quaternions in another order."""
    quaternion = se3.quaternion(pose[..., :3, :3])[..., index]
    return se3.pose(se3.rotation_from_quaternion(quaternion), pose[..., :3, 3])


def placed(pose: Array, matrix: Array) -> Array:
    """Poses with positions multiplied by a matrix (3, 3)."""
    return se3.pose(pose[..., :3, :3], pose[..., :3, 3] @ matrix.T)


def turned(pose: Array, matrix: Array) -> Array:
    """Poses in coordinates rotated by a matrix (3, 3): positions and rotations multiplied by it."""
    return se3.pose(matrix @ pose[..., :3, :3], pose[..., :3, 3] @ matrix.T)


def mirrored(pose: Array, matrix: Array) -> Array:
    """Poses converted from mirrored to right-handed coordinates by a matrix (3, 3)."""
    return se3.pose(matrix @ pose[..., :3, :3] @ matrix.T, pose[..., :3, 3] @ matrix.T)


def _conjugated(pose: Array) -> Array:
    return se3.pose(np.swapaxes(pose[..., :3, :3], -1, -2), pose[..., :3, 3])


def _identity(pose: Array) -> Array:
    return np.eye(4)
