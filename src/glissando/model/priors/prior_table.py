"""How priors are read from the tables of a robot file, and the parts that they share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.rest_shape import STRAIGHT


class PriorTable(Protocol):
    """A table of a robot file as a prior reads it, `glissando.io.toml_table.Table`."""

    def peek(self, key: str) -> Any:
        """The raw value of a key, or None."""

    def fail(self, key: str, problem: str) -> Exception:
        """An error that names the file and the key."""

    def close(self) -> None:
        """Raise unless every key was read."""

    def table(self, key: str, *, required: bool = False) -> PriorTable | None:
        """A sub-table, or None when it is absent and not required."""

    def tables(self, key: str) -> Sequence[PriorTable]:
        """An array of tables; empty when absent."""

    def number(self, key: str, default: float | None = None, *, positive: bool = True) -> float:
        """A finite number."""

    def numbers(self, key: str) -> Array:
        """Numbers, at least one."""

    def texts(self, key: str) -> list[str]:
        """Strings, at least one."""

    def vector(
        self,
        key: str,
        size: int,
        default: Array | None = None,
        *,
        positive: bool = False,
        pairs: bool = True,
    ) -> Array:
        """`size` numbers; six may be a pair [linear, angular] if `pairs`."""

    def rows(
        self, key: str, count: int, size: int, *, positive: bool = True, signed: bool = False
    ) -> Array:
        """`count` vectors (count, size)."""

    def pose(self) -> Array:
        """`position` and `quaternion` as a pose (4, 4)."""


def read_segments(prior: PriorTable, jumps: str) -> dict[str, Array]:
    """Strain densities (6,), or of S segments with their joints and jumps.

    Args:
        prior: The [prior] table.
        jumps: Key of the jumps at the joints.
    """
    if prior.peek("joints") is None:
        return {"psd_strain_arclength": prior.vector("psd_strain_arclength", 6, positive=True)}
    joints = prior.numbers("joints")
    if np.any(np.diff(joints, prepend=0.0) <= 0.0):
        raise prior.fail("joints", "must increase from above 0.")
    psd = prior.rows("psd_strain_arclength", joints.size + 1, 6)
    strain_jumps = prior.rows(jumps, joints.size, 6, positive=False)
    return {"psd_strain_arclength": psd, "joints": joints, "jumps": strain_jumps}


def read_rest(robot: PriorTable, segments: int) -> dict[str, Array]:
    """The rest strain, and its slope where it is given; one row a segment, or (6,) of the body."""
    rest = {}
    for key in ("rest_strain", "rest_slope"):
        value = robot.peek(key)
        if isinstance(value, list) and value and isinstance(value[0], list):
            rest[key] = robot.rows(key, segments, 6, positive=False, signed=True)
        elif key == "rest_strain" or value is not None:
            rest[key] = robot.vector(key, 6, STRAIGHT)
    return rest


def segments_table(psd: Array, joints: Array, jumps: Array, key: str) -> dict[str, Any]:
    """What `read_segments` reads."""
    if not joints.size:
        return {"psd_strain_arclength": psd.tolist()}
    if psd.ndim == 1:
        psd, jumps = np.tile(psd, (joints.size + 1, 1)), np.zeros((joints.size, 6))
    table = {"joints": joints, "psd_strain_arclength": psd, key: jumps}
    return {name: value.tolist() for name, value in table.items()}


def pose_table(pose: Array) -> dict[str, Any]:
    """A pose (4, 4) as `PriorTable.pose` reads it."""
    quaternion = se3.quaternion(pose[:3, :3])
    return {"position": pose[:3, 3].tolist(), "quaternion": quaternion.tolist()}
