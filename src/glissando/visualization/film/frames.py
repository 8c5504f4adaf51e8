"""Data of the frames of an animation; nothing is drawn here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.confidence_tube import SIGMAS_95, confidence_tube
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.sensors.readings import Readings
from glissando.visualization.arrows import arrows_of
from glissando.visualization.canvas import MM
from glissando.visualization.sampling import drawn_at
from glissando.visualization.sites import NEAR, seen_positions, sites_of

_SENSOR_GAP = 0.25  # s, largest time to the nearest reading at which a sensor is shown
_ALONG = 63  # steps along the tube, minimum


@dataclass(frozen=True)
class Frames:
    """Data of F frames, world frame, millimetres; NaN where there is nothing to show.

    Attributes:
        time: Times (F,), s.
        arclength: Points along the body (N,).
        line: Positions of these points (F, N, 3).
        std: Standard deviations of their positions (F, N).
        tube: Rings (F, R, A, 3) of the 95 % surface, across the body.
        shade: Standard deviations (F, R) at the rings.
        sensors: Labels of the sensors (S).
        place: Arclengths of the sensors (F, S).
        dot: Positions of the sensors (F, S, 3).
        dot_std: Standard deviations of these positions (F, S).
        triad: True origins and tips of x, y, z (F, C, 4, 3).
        point: True positions (F, P, 3).
        force: Lines (F, S, 3) of the arrows of estimated forces and of their ellipsoids.
        forces: Legend of the arrows; empty if the prior has no loads.
    """

    time: Array
    arclength: Array
    line: Array
    std: Array
    tube: Array
    shade: Array
    sensors: list[str]
    place: Array
    dot: Array
    dot_std: Array
    triad: Array
    point: Array
    force: Array
    forces: str


def frames_at(
    posterior: Posterior, readings: Sequence[Readings], truth: Sequence[Readings], times: Array
) -> Frames:
    """Evaluate what is drawn at `times` (F,) in seconds, in one query of the posterior.

    A sensor is shown at the arclength of its nearest reading within 0.25 s, and truth at the
    nearest sample within 0.1 s. Raises OutsideGridError for a time off the grid.
    """
    grid = posterior.grid
    sites = sites_of(readings, grid, Readings)
    place = sensor_places(sites, times)
    body = drawn_at(grid.arclength, _ALONG)
    arclength = np.nan_to_num(np.hstack([np.tile(body, (times.size, 1)), place]), nan=body[0])
    at = posterior.at(arclength, times[:, None])
    std, hidden = at.std_position * MM, np.where(np.isnan(place), np.nan, MM)
    of_body = np.s_[:, : body.size]
    tube, ring = confidence_tube(at.pose[of_body], at.position_covariance()[of_body], SIGMAS_95)
    true, forces = sites_of(truth, grid), arrows_of(posterior, times)
    drawn = [forces.strokes(), forces.rings()] if forces else []
    lines = [MM * part.reshape(times.size, -1, 3) for part in drawn]
    reach = 0.05 * (body[-1] - body[0])
    return Frames(
        time=times,
        arclength=body * MM,
        line=at.position[:, : body.size] * MM,
        std=std[:, : body.size],
        tube=tube * MM,
        shade=std[:, ring],
        sensors=[site.label for site in sites],
        place=place * MM,
        dot=at.position[:, body.size :] * hidden[..., None],
        dot_std=at.std_position[:, body.size :] * hidden,
        triad=true_marks([s for s in true if s.values.ndim == 3], times, reach),
        point=true_marks([s for s in true if s.values.ndim == 2], times, reach)[:, :, 0],
        force=np.concatenate([np.zeros((times.size, 0, 3)), *lines], axis=1),
        forces=forces.words if forces else "",
    )


def sensor_places(sites: Sequence[Readings], times: Array) -> Array:
    """Arclengths (F, S) of the sensors at times (F,); NaN without a reading within 0.25 s."""
    place = np.full((times.size, len(sites)), np.nan)
    for column, site in zip(place.T, sites, strict=True):
        rows, near = nearest_samples(site, times, _SENSOR_GAP)
        column[near] = site.arclength[rows[near]]
    return place


def nearest_samples(site: Readings, times: Array, within: float) -> tuple[Index, NDArray[np.bool_]]:
    """Rows of the readings nearest to times (F,), and whether they are `within` s."""
    after = np.searchsorted(site.time, times).clip(1, max(site.time.size - 1, 1))
    nodes = np.append(site.time, np.inf)
    rows = after - (times - nodes[after - 1] <= nodes[after] - times)
    return rows, np.abs(nodes[rows] - times) <= within


def true_marks(sites: Sequence[Readings], times: Array, reach: float) -> Array:
    """Origins and tips of the true axes (F, C, 4, 3) in mm; NaN without a sample within 0.1 s."""
    out = np.full((times.size, len(sites), 4, 3), np.nan)
    for i, site in enumerate(sites):
        rows, near = nearest_samples(site, times, NEAR)
        origin = seen_positions(site)[rows[near]]
        out[near, i] = origin[:, None]
        if site.values.ndim == 3:
            out[near, i, 1:] += reach * np.swapaxes(site.values[rows[near], :3, :3], -1, -2)
    return out * MM
