"""Jackknife replicates: parameters of a tendon robot learned without a part of the data.

The spread of their predictions is the uncertainty due to the parameters: the covariance of a
prediction is (n − 1)/n times the sum of the squares of the n deviations from the prediction of all
data. Source: Efron and Tibshirani 1993, chapter 11.

Replicates do not show what the data leave undetermined. For this, `left_open` has the parameters
moved by a standard deviation along what the prior alone decided; squares of deviations add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.table import Table

EACH = ("radius", "angle", "stiffness", "slack", "play")
"""Fields of a replicate with one number for each tendon."""
TIP = "tip"
"""Name of the stream of the marker at the tip."""
_SECTIONS = ("section_stiffness", "rest_strain")
_MARKER = ("frame", "mount")


@dataclass(frozen=True)
class Replicate:
    """Parameters of T tendons and a rod of S segments, without a part of the recording.

    Attributes:
        radius: Distance of each tendon from the backbone (T,), m.
        angle: Angle in the cross-section of the base (T,), rad.
        stiffness: Tension per stretch (T,), N/m.
        slack: Displacement at which each becomes taut in the straight robot (T,), m.
        play: Displacement that is lost at a reversal of a servo (T,), m.
        softness: Displacement over which a tendon becomes taut, m.
        section_stiffness: Stiffness of each segment (S, 6), as in [mechanics].
        rest_strain: Strain of each segment without loads (S, 6).
        frame: Logarithm (6,) of the frame of the marker's tracker, as of a sensor parameter.
        mount: Logarithm (6,) of the marker's mount at the tip, as of a sensor parameter.
    """

    radius: Array
    angle: Array
    stiffness: Array
    slack: Array
    play: Array
    softness: float
    section_stiffness: Array
    rest_strain: Array
    frame: Array
    mount: Array

    def to_table(self) -> dict[str, Any]:
        """Entry of [[tendons.replicates]], in the form that `read_replicates` reads."""
        return {
            field.name: np.asarray(getattr(self, field.name)).tolist() for field in fields(self)
        }


def read_replicates(
    tendons: Table, key: str, count: int, sections: int | None
) -> tuple[Replicate, ...]:
    """Read the entries [[tendons.replicates]], or those of another key, of a robot file.

    Args:
        tendons: The table [tendons].
        key: Key of the list of entries.
        count: Number of tendons.
        sections: Number of segments of [mechanics]; None without that table.

    Raises:
        GlissandoError: A value is missing or impossible.
    """
    entries = tendons.tables(key)
    if entries and sections is None:
        raise tendons.fail(key, "need [mechanics], whose stiffness they differ in.")
    return tuple(_replicate(entry, count, sections or 0) for entry in entries)


def _replicate(entry: Table, count: int, sections: int) -> Replicate:
    positive = ("radius", "stiffness")
    tendons = {
        name: entry.vector(name, count, positive=name in positive, pairs=False) for name in EACH
    }
    rod = {name: entry.rows(name, sections, 6, positive=False, signed=True) for name in _SECTIONS}
    marker = {name: entry.vector(name, 6) for name in _MARKER}
    replicate = Replicate(softness=entry.number("softness"), **tendons, **rod, **marker)
    if np.any(replicate.section_stiffness <= 0.0):
        raise entry.fail("section_stiffness", "has numbers that are not above zero.")
    if np.any(replicate.play < 0.0):
        raise entry.fail("play", f"is {replicate.play.tolist()}; give zero or more.")
    entry.close()
    return replicate
