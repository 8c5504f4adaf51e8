"""Data of a page: the robot, its uncertainty, sensors and truth over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from glissando.errors import GlissandoError, OutsideGridError
from glissando.estimation.posterior import Posterior
from glissando.evaluation.metrics import errors_against
from glissando.geometry.covariance import symmetric_root
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings
from glissando.model.tube import Tube
from glissando.visualization.arrows import Arrows, arrows_of
from glissando.visualization.canvas import MM
from glissando.visualization.film.frames import nearest_samples, sensor_places, true_marks
from glissando.visualization.sampling import drawn_at
from glissando.visualization.sites import NEAR, sites_of

Progress = Callable[[int, int], None]  # moments done, moments in all

_RATE = 20.0  # Hz, minimum
_ALONG = 48  # steps along the body, minimum
_MOST = 1500  # moments of a page, which bounds its size
_CHUNK = 100  # moments in a query, which bounds memory


@dataclass(frozen=True)
class Solid:
    """A body near the robot: vertices (V, 3), m, triangles (F, 3), colour, and transparency."""

    vertices: Array
    triangles: Index
    colour: str
    clear: bool = False


@dataclass(frozen=True)
class Scene:
    """Data of F moments, world frame, SI units; NaN where there is nothing to show.

    Attributes:
        time: Times (F,).
        arclength: Points along the body (N,).
        pose: Poses of these points (F, N, 4, 4).
        root: Symmetric square roots (F, N, 3, 3) of the covariances of their positions.
        sensors: Labels of the sensors (S).
        place: Arclengths of the sensors (F, S).
        sites: Labels of the truth sites (C).
        site_place: Arclengths of the truth sites (F, C).
        truth: Origins and tips of the true axes (F, C, 4, 3).
        miss: Position errors of the estimate against truth (F, C).
        nees: Normalised squared position errors (F, C), with three degrees of freedom.
        tube: Tube for whose coverage the robot file has a guarantee, if any.
        solids: Solids around the robot.
        arrows: Estimated forces; None unless the prior has loads.
    """

    time: Array
    arclength: Array
    pose: Array
    root: Array
    sensors: list[str]
    place: Array
    sites: list[str]
    site_place: Array
    truth: Array
    miss: Array
    nees: Array
    tube: Tube | None = None
    solids: tuple[Solid, ...] = ()
    arrows: Arrows | None = None


def scene_of(
    posterior: Posterior,
    readings: Sequence[Readings] = (),
    truth: Sequence[Readings] = (),
    *,
    window: tuple[float, float] | None = None,
    tube: Tube | None = None,
    progress: Progress | None = None,
) -> Scene:
    """Evaluate a posterior at its time nodes and the midpoints between, at 20 Hz at least.

    The posterior evaluates every moment; the page interpolates nothing.

    Args:
        posterior: Estimate to show.
        readings: Streams of the sensors, shown at their nearest reading within 0.25 s.
        truth: Streams of the truth, shown at the nearest sample within 0.1 s.
        window: First and last time, s; None for the whole estimate.
        tube: A whole-body tube to draw beside the Gaussian one.
        progress: Called with the numbers of moments done and in all.

    Raises:
        OutsideGridError: The window is off the grid.
        GlissandoError: The grid has a single arclength.
    """
    grid = posterior.grid
    if grid.arclength.size == 1:
        raise GlissandoError("A grid of a single arclength has no body to show; give two.")
    times = moments(grid.time, window)
    body = drawn_at(grid.arclength, _ALONG)
    shape = times.size, body.size
    pose, root = np.empty((*shape, 4, 4)), np.empty((*shape, 3, 3))
    for first in range(0, times.size, _CHUNK):
        part = slice(first, first + _CHUNK)
        at = posterior.at(body, times[part, None])
        pose[part], root[part] = at.pose, symmetric_root(at.cov_position_world)
        if progress:
            progress(min(first + _CHUNK, times.size), times.size)
    used, true = sites_of(readings, grid, Readings), sites_of(truth, grid)
    misses = np.array([_position_errors(posterior, site, times) for site in true])
    site_place, miss, nees = misses.reshape(len(true), 3, times.size).transpose(1, 2, 0)
    return Scene(
        time=times,
        arclength=body,
        pose=pose,
        root=root,
        sensors=[site.label for site in used],
        place=sensor_places(used, times),
        sites=[site.label for site in true],
        site_place=site_place,
        truth=true_marks(true, times, 0.05 * (body[-1] - body[0])) / MM,
        miss=miss,
        nees=nees,
        tube=tube,
        arrows=arrows_of(posterior, times),
    )


def moments(nodes: Array, window: tuple[float, float] | None) -> Array:
    """Times to show: nodes (K,) and points between, at 20 Hz at least, 1500 at most.

    Raises OutsideGridError for a window, in seconds, that is empty or not inside the grid.
    """
    first, last = window or (nodes[0], nodes[-1])
    if not nodes[0] <= first <= last <= nodes[-1]:
        raise OutsideGridError(
            f"The window {seconds(first, last)} s is not inside the estimate, "
            f"{seconds(nodes[0], nodes[-1])} s; give one that is."
        )
    nodes = nodes[(nodes >= first) & (nodes <= last)]
    nodes = np.unique(np.concatenate([[first], nodes, [last]]))
    return np.unique(drawn_at(nodes, int(np.ceil(_RATE * (last - first) - 1e-9)), _MOST))


def _position_errors(posterior: Posterior, site: Readings, times: Array) -> Array:
    """Arclength, position error and its NEES (3, F) of the samples shown; NaN without one."""
    rows, near = nearest_samples(site, times, NEAR)
    out = np.full((3, times.size), np.nan)
    shown, back = np.unique(rows[near], return_inverse=True)
    if shown.size:
        errors = errors_against(posterior, site.select(shown))
        misses = np.stack([errors.arclength, errors.position, errors.nees_position])
        out[:, near] = misses[:, back]
    return out
