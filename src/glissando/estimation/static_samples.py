"""Samples of static shapes given the readings of one time, where no Gaussian describes them.

If a robot bends widely and has sensors at few places, shapes far apart may explain the readings,
along a curve or in several modes. An estimate finds one, and its covariance is local to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando._kernels.threads import one_thread
from glissando.errors import GlissandoError
from glissando.estimation.given import require_list, require_model, static_model
from glissando.estimation.static_iteration import iterate
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior, load_kernels
from glissando.model.priors.static import STATIC_DOF
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.state import State, concatenate
from glissando.solver.gauss_newton import SolverOptions
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.static_equations import linearize_static

_OPTIONS = SolverOptions(15, tolerance=1.0)
_TOGETHER = 100  # shapes that are solved at once
_TRIES = 60  # most draws for each requested shape
_RARE = 0.1  # share of draws that lead to a shape, below which some start at shapes found before
_LARGEST = 10_000


def sample_static(
    model: Prior | Robot,
    arclength: ArrayLike,
    readings: Sequence[Readings],
    *,
    size: int = 100,
    rng: np.random.Generator | None = None,
) -> State:
    """Draw static shapes from the posterior given the readings of one time.

    Each draw is the most likely shape after errors of prior and readings are drawn, found from a
    shape drawn from the prior (randomised maximum likelihood; Oliver, He and Reynolds, 1996). In a
    linear problem these are draws from the posterior. In a nonlinear one they approximate it and
    cover all shapes that explain the readings, whereas the covariance of `estimate` and
    `estimate_static` describes only the neighbourhood of the shape they find. Draws that lead to no
    plausible shape are repeated; where most do, half of the rounds start from shapes found before.

    Args:
        model: The robot, whose sensor parameters must be known, or the prior of its shapes; not a
            mechanical prior.
        arclength: Nodes (N,), metres.
        readings: Readings of each sensor, all of the same shape, whatever their times.
        size: Number of shapes to draw.
        rng: Random number generator; `numpy.random.default_rng(0)` if None.

    Returns:
        Shapes (size, N) at rest.

    Raises:
        GlissandoError: The size is not from 1 to 10,000, the prior is mechanical, or hardly any
            draw leads to a shape.
        SensorError: A sensor reads a velocity, or slides in a channel.
        UnobservableError: Prior and readings leave a direction of a shape undetermined.

    >>> from glissando import PositionReadings, load_robot
    >>> robot = load_robot("tdcr466-segments")
    >>> tip = PositionReadings(time=[0], arclength=[0.466], values=[[0.15, 0.0, 0.3]], cov=1e-6)
    >>> shapes = sample_static(robot, robot.arclength_nodes, [tip])
    >>> middle, end = shapes.pose[:, 2, :3, 3], shapes.pose[:, -1, :3, 3]
    >>> bool(end.std(axis=0).max() < 0.002), bool(middle.std(axis=0).max() > 0.03)  # metres
    (True, True)
    """
    require_list(readings, Readings, "readings")
    prior, readings = static_model(model, readings)
    require_model(prior, np.asarray(arclength, dtype=float))
    if not 1 <= size <= _LARGEST:
        raise GlissandoError(f"size is {size}; draw 1 to {_LARGEST:,} shapes.")
    if isinstance(prior, MechanicalPrior):
        raise GlissandoError("Shapes of a rod follow from its loads; draw with a prior of strain.")
    load_kernels(prior, "static_steps")
    rng = np.random.default_rng(0) if rng is None else rng
    with one_thread():
        located = _repeated(arclength, [r for r in readings if len(r)], min(_TOGETHER, size))
        return _collect_draws(prior, located, size, rng)


def _collect_draws(
    prior: Prior, located: LocatedReadings, size: int, rng: np.random.Generator
) -> State:
    """Shapes (size, N) from as many rounds of draws as are necessary.

    Raises:
        GlissandoError: Hardly any draw leads to a shape.
        UnobservableError: Prior and readings leave a direction of a shape undetermined.
    """
    collected: list[State] = []
    tried, missing, among_found = 0, size, False
    while missing and tried < _TRIES * size:
        known = concatenate(*collected) if among_found else None
        shapes, failed = _draw_shapes(prior, located, rng, known)
        collected.append(shapes.take(np.flatnonzero(~failed)[:missing]))
        tried, missing = tried + len(failed), missing - len(collected[-1].pose)
        among_found = 0 < size - missing < _RARE * tried and not among_found
    if missing:
        raise GlissandoError(
            f"Only {size - missing} of {tried} draws led to a shape that explains the readings; "
            f"check their mounts, units and noise, and the prior's densities."
        )
    return concatenate(*collected)


def _repeated(arclength: ArrayLike, readings: Sequence[Readings], count: int) -> LocatedReadings:
    """The readings, repeated for each of `count` shapes."""
    copied = []
    for r in readings:
        rows = np.tile(np.arange(len(r)), count)
        copied.append(r.select(rows).changed(time=np.repeat(np.arange(float(count)), len(r))))
    return locate(Grid.apart(arclength, count), copied)


def _draw_shapes(
    prior: Prior, located: LocatedReadings, rng: np.random.Generator, known: State | None
) -> tuple[State, NDArray[np.bool_]]:
    """Shapes (S, N) for newly drawn errors, and the mask (S,) of those not found.

    The search starts at shapes drawn from the prior, or at some of the shapes `known` (·, N).

    Raises:
        UnobservableError: Prior and readings leave a direction of a shape undetermined.
    """
    noise = draw_noise(prior, located, rng)
    if known is None:
        start = shapes_of_prior(prior, located.grid, noise)
    else:
        start = known.take(rng.integers(len(known.pose), size=located.grid.time.size))
        start = start.with_fields_of(prior.rest_state(located.grid))
    shapes, _, failed = iterate(prior, located, start, _OPTIONS, noise)
    return State(shapes.pose, shapes.strain, np.zeros_like(shapes.strain)), failed


def draw_noise(prior: Prior, located: LocatedReadings, rng: np.random.Generator) -> list[Array]:
    """Standard normal residuals (M, r) of each batch of factors of static shapes, whitened.

    Args:
        prior: Prior of the shapes, whose batches come first.
        located: Readings of the shapes.
        rng: Source of randomness.
    """
    rest = prior.rest_state(located.grid)
    residuals = (terms.residual for _, terms in linearize_static(prior, located, rest).terms)
    return [rng.standard_normal(residual.shape) for residual in residuals]


def shapes_of_prior(prior: Prior, grid: Grid, noise: Sequence[Array]) -> State:
    """Shapes (S, N) of a prior, one for each time of the grid.

    Args:
        prior: Prior of the shapes.
        grid: Arclength nodes and numbers of the shapes.
        noise: Whitened residuals of the batches of the prior's factors, as `draw_noise` returns.

    Raises:
        UnobservableError: The prior alone does not determine a shape.
    """
    rest = prior.rest_state(grid)
    here = linearize_static(prior, locate(grid, []), rest, noise)
    step = np.zeros((*grid.shape, rest.dof))
    solved = here.cholesky.solve(here.rhs.reshape(-1, STATIC_DOF))
    step[..., :STATIC_DOF] = solved.reshape(here.rhs.shape)
    return prior.retract_strains(grid, rest, step)
