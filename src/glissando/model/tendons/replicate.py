"""What the numbers of a tendon robot are when learned without a part of the data.

How far apart such replicates predict is what is not known of the numbers. The covariance of a
prediction, the jackknife, is (n − 1)/n times the sum of the squares of their n deviations from that
of all data. Source: Efron and Tibshirani 1993, chapter 11.

Of what no data tell, replicates say nothing. Those that are left open are the numbers moved a
standard deviation along what the prior alone decided, and the squares of their deviations add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.table import Table

EACH = ("radius", "angle", "stiffness", "slack", "play")
"""What a replicate has one of for each tendon."""
TIP = "tip"
"""Name of the stream of the marker at the tip."""
_SECTIONS = ("section_stiffness", "rest_strain")
_MARKER = ("frame", "mount")


@dataclass(frozen=True)
class Replicate:
    """The numbers of T tendons and of a rod of S segments without a part of the recording.

    Attributes:
        radius: Distance of each tendon from the backbone (T,), m.
        angle: Angle in the cross-section of the base (T,), rad.
        stiffness: Tension for a stretch (T,), N/m.
        slack: Displacement that pulls each just taut in the straight robot (T,), m.
        play: Displacement that is lost when a servo turns back (T,), m.
        softness: Displacement over which a tendon becomes taut, m.
        section_stiffness: Stiffness of each segment (S, 6), as in [mechanics].
        rest_strain: Strain of each segment without loads (S, 6).
        frame: Logarithm (6,) of where the marker's tracker stands, as of its sensor parameter.
        mount: Logarithm (6,) of where the marker is at the tip.
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
        """An entry of [[tendons.replicates]], as `read_replicates` reads it."""
        return {
            field.name: np.asarray(getattr(self, field.name)).tolist() for field in fields(self)
        }


def read_replicates(
    tendons: Table, key: str, count: int, sections: int | None
) -> tuple[Replicate, ...]:
    """The entries [[tendons.replicates]], or of another key, of a robot file.

    Args:
        tendons: The table [tendons].
        key: Which of its lists of entries.
        count: How many tendons there are.
        sections: How many segments [mechanics] has; None where there is no such table.

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
