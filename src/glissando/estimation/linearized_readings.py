"""Linearised readings of a window: factors, innovations, and drawn noise in their place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.slope_share import add_noise
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import Index
from glissando.model.sensors.readings import Readings
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder


@dataclass(frozen=True)
class Innovations:
    """Innovations of readings of one stream at the solution.

    Attributes:
        stream: The stream's label.
        nis: Squared normalised innovations (M,).
        dof: Degrees of freedom of each innovation.
        time: Times (M,) of the readings, s.
        arclength: Arclengths (M,) of the readings, m.
    """

    stream: str
    nis: Array
    dof: int
    time: Array
    arclength: Array


@dataclass(frozen=True)
class LinearizedReadings:
    """Linearised readings (M,), of one stream or of all that are stored as rows.

    Attributes:
        stream: The stream; None for readings stored as rows.
        rows: Indices (M,) in the stream, or among all rows.
        batch: Factors of the readings.
        weights: Robust weights (M,).
    """

    stream: Readings | None
    rows: Index
    batch: Factors
    weights: Array

    def last(self, fresh: Mapping[str, int], held: HeldReadings) -> Index:
        """Indices of those that are among each stream's last `fresh` readings."""
        stream = self.stream
        begin = held.rows.old if stream is None else len(stream) - fresh[stream.label]
        return np.asarray((self.rows >= begin).nonzero()[0])

    def innovations(self, which: Index, nis: Array, held: HeldReadings) -> Iterator[Innovations]:
        """Innovations, stream by stream, from the squares `nis` of the readings `which`."""
        rows, stream = self.rows[which], self.stream
        if stream is not None:
            dof = self.batch.terms.residual.shape[1]
            yield Innovations(stream.label, nis, dof, stream.time[rows], stream.arclength[rows])
            return
        time, arclength, end = held.rows.time[rows], held.rows.arclength[rows], 0
        for number, each in groupby(held.rows.stream[rows].tolist()):
            begin, end = end, end + sum(1 for _ in each)
            own, (label, dof) = slice(begin, end), held.labels[number]
            yield Innovations(label, nis[own], dof, time[own], arclength[own])


def sums_of_noise(
    every: Sequence[LinearizedReadings], layout: Layout, count: int, rng: np.random.Generator
) -> NormalEquationsBuilder:
    """Sums of the readings of `count` nodes with drawn noise for residuals."""
    builder = NormalEquationsBuilder.apart(layout, count)
    for readings in every:
        add_noise(builder, readings.batch, readings.weights, rng)
    return builder
