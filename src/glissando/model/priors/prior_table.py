"""The parts of a robot file that priors share: segments and rest strain."""

from __future__ import annotations

from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.table import Table


def read_segments(prior: Table, jumps: str) -> dict[str, Array]:
    """Read strain densities (6,), or (S, 6) of segments with their joints and jumps.

    Args:
        prior: The [prior] table.
        jumps: Key of the jumps at the joints.
    """
    joints = prior.places("joints")
    if not joints.size:
        return {"psd_strain_arclength": prior.vector("psd_strain_arclength", 6, positive=True)}
    psd = prior.rows("psd_strain_arclength", joints.size + 1, 6)
    strain_jumps = prior.rows(jumps, joints.size, 6, positive=False)
    return {"psd_strain_arclength": psd, "joints": joints, "jumps": strain_jumps}


def read_rest(robot: Table, segments: int) -> dict[str, Array]:
    """Read the rest strain, and its slope if given: (6,) of the body, or one row a segment."""
    rest = {}
    for key in ("rest_strain", "rest_slope"):
        value = robot.peek(key)
        if isinstance(value, list) and value and isinstance(value[0], list):
            rest[key] = robot.rows(key, segments, 6, positive=False, signed=True)
        elif key == "rest_strain" or value is not None:
            rest[key] = robot.vector(key, 6, STRAIGHT)
    return rest


def segments_table(psd: Array, joints: Array, jumps: Array, key: str) -> dict[str, Any]:
    """Entries of a [prior] table, in the form that `read_segments` reads."""
    if not joints.size:
        return {"psd_strain_arclength": psd.tolist()}
    psd = np.broadcast_to(psd, (joints.size + 1, 6))
    jumps = jumps if np.size(jumps) else np.zeros((joints.size, 6))
    table = {"joints": joints, "psd_strain_arclength": psd, key: jumps}
    return {name: value.tolist() for name, value in table.items()}
