"""Simulation-based calibration: consistency of the posterior with a robot file's own prior.

Sessions are drawn from the prior and estimated, and the truth's rank in the posterior is recorded.
If prior, sensors and estimator are consistent, the ranks are uniform. Source: Talts et al.,
*Validating Bayesian Inference Algorithms with Simulation-Based Calibration* (2018); bands from
Säilynoja, Bürkner and Vehtari, *Graphical test for discrete uniformity* (Statistics and Computing
32, 2022).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.special import bdtr, chdtr, ndtr

from glissando.errors import EstimateWarning, GlissandoError, RobotFileError
from glissando.estimation.batch import estimate
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.estimation.posterior import Posterior
from glissando.estimation.state_estimate import StateEstimate
from glissando.evaluation.prior_predictive import PriorPredictive, Session, session_layout
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.priors.prior import Prior
from glissando.model.priors.registry import prior_class
from glissando.model.quantiles import binomial_quantile
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.model.table import Table

FIELDS = ("pose", "strain", "velocity")
QUANTITIES = (
    *(f"{field} {axis}" for field in FIELDS for axis in ("x", "y", "z", "rx", "ry", "rz")),
    *(f"{field}, all six" for field in FIELDS),
)
"""Ranked quantities of a state: each component, and the squared normalised error of each six."""

_POINTS = 40  # intervals of (0, 1), between which the distribution function is compared
_SIMULATED = 20_000  # simulated sets of uniform ranks, from which bands are computed
_FEWEST = 20

Progress = Callable[[int, int], None]
"""Called after each session with its number from 1 and the number of sessions."""


@dataclass(frozen=True)
class RankCheck:
    """Ranks of one quantity over all sessions.

    Attributes:
        name: The quantity.
        ranks: Probability integral transforms (M,) of the truth under the posterior.
        p_value: Probability that uniform ranks deviate as far at any point.
    """

    name: str
    ranks: Array
    p_value: float

    @property
    def ecdf_difference(self) -> Array:
        """Empirical distribution function (P,) of the ranks at `rank_points`, minus the uniform."""
        points = rank_points()
        return np.searchsorted(np.sort(self.ranks), points, side="right") / self.ranks.size - points


@dataclass(frozen=True)
class SimulationCheck:
    """Ranks of every quantity, and a joint test of their uniformity.

    Attributes:
        estimator: 'batch' or 'online'.
        checks: Ranks of each quantity.
        level: Probability that all ranks stay in their bands if the posterior is consistent.
        not_converged: Number of estimates that did not converge; their ranks are included.
    """

    estimator: str
    checks: list[RankCheck]
    level: float
    not_converged: int

    @property
    def outside(self) -> list[RankCheck]:
        """Checks of the quantities whose ranks leave their band."""
        return [c for c in self.checks if c.p_value < self.p_limit]

    @property
    def p_limit(self) -> float:
        """The p-value below which a quantity is outside: 1 − level over their number."""
        return (1.0 - self.level) / len(self.checks)

    def as_json(self) -> dict[str, Any]:
        """The result of the test and of every quantity, as a JSON object."""
        return {
            "estimator": self.estimator,
            "sessions": int(self.checks[0].ranks.size),
            "not_converged": self.not_converged,
            "level": self.level,
            "uniform": not self.outside,
            "quantities": [
                {
                    "name": c.name,
                    "p_value": c.p_value,
                    "uniform": c.p_value >= self.p_limit,
                    "largest_difference": float(np.abs(c.ecdf_difference).max()),
                }
                for c in self.checks
            ],
        }


def rank_points() -> Array:
    """Evenly spaced points inside (0, 1) at which distribution functions are compared."""
    return np.arange(1, _POINTS) / _POINTS


@cache
def _tails(count: int) -> Array:
    """Two-sided tail probabilities (count + 1, P) of 0 … count uniform ranks below each point."""
    lower = bdtr(np.arange(count + 1)[:, None], count, rank_points())
    upper = 1.0 - np.vstack([np.zeros(lower.shape[1]), lower[:-1]])
    return np.minimum(1.0, 2.0 * np.minimum(lower, upper))


def _least_tail(below: Index, count: int) -> Array:
    """Least tail probability (S,) over the points, for numbers (S, P) of ranks below each."""
    out: Array = np.take_along_axis(_tails(count), below, axis=0).min(axis=1)
    return out


@cache
def _least_tails(count: int) -> Array:
    """Least tail probabilities (S,) of simulated sets of uniform ranks, sorted."""
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(count, np.full(_POINTS, 1.0 / _POINTS), _SIMULATED)
    return np.sort(_least_tail(np.cumsum(drawn, axis=1)[:, :-1], count))


def bands(count: int, chance: float) -> tuple[Array, Array]:
    """Simultaneous band of the ECDF difference (P,) of uniform ranks.

    Args:
        count: Number of ranks.
        chance: Probability that uniform ranks leave the band at any point.

    Returns:
        Lower and upper limits at `rank_points`.
    """
    tails = _least_tails(count)
    limit = tails[min(int(chance * tails.size), tails.size - 1)]
    points = rank_points()
    low, high = (binomial_quantile(p, count, points) for p in (0.5 * limit, 1.0 - 0.5 * limit))
    return low / count - points, high / count - points


def rank_checks(ranks: dict[str, Array]) -> list[RankCheck]:
    """Test ranks of each quantity for uniformity, simultaneously at all points.

    Args:
        ranks: Probability integral transforms (M,) by quantity, with the same M for all.
    """
    count = len(next(iter(ranks.values())))
    tails, points = _least_tails(count), rank_points()
    out = []
    for name, each in ranks.items():
        below = np.searchsorted(np.sort(each), points, side="right")
        least = float(_least_tail(below[None], count)[0])
        p_value = (1 + np.searchsorted(tails, least, side="right")) / (1 + tails.size)
        out.append(RankCheck(name, each, float(p_value)))
    return out


def scaled_prior(prior: Prior, factor: float) -> Prior:
    """Copy of a prior with all its standard deviations multiplied by a factor.

    Args:
        prior: The prior.
        factor: Factor of the standard deviations.
    """
    table = prior.to_table()

    def scaled(key: str, value: Any) -> Any:
        if isinstance(value, dict):
            return {inner: scaled(inner, each) for inner, each in value.items()}
        if key.startswith(("psd_", "var_")):
            return (factor**2 * np.asarray(value)).tolist()
        if key.startswith("std_"):
            return (factor * np.asarray(value)).tolist()
        return value

    robot = Table(scaled("", table), "scaled prior", RobotFileError)
    entries = robot.subtable("prior")
    cls = prior_class(entries.text("kind"))
    return cls.from_table(entries, robot)


def simulate_and_rank(
    robot: Robot,
    sessions: int,
    *,
    layout: tuple[Grid, Sequence[Readings]] | None = None,
    estimators: Sequence[str] = ("batch", "online"),
    prior_factor: float = 1.0,
    seed: int = 0,
    level: float = 0.95,
    progress: Progress | None = None,
) -> list[SimulationCheck]:
    """Draw sessions from a robot's prior, estimate each, and check the ranks of the truth.

    In each session the state at one random place and time (online the newest time) is ranked, and
    the sensor parameters at the same time, so that ranks of different sessions are independent.

    Args:
        robot: The robot.
        sessions: Number of sessions.
        layout: Grid, and readings whose places, times and noise are used; by default those of
            `session_layout`.
        estimators: 'batch', 'online', or both.
        prior_factor: Factor of the standard deviations of the prior for estimation, relative to
            the prior for drawing.
        seed: Seed of all random numbers.
        level: Probability that all ranks stay in their bands if the posterior is consistent.
        progress: Called after each session.

    Raises:
        GlissandoError: There are too few sessions, or the prior cannot be drawn from, for instance
            because its linearisation does not hold.
    """
    if sessions < _FEWEST:
        raise GlissandoError(f"{sessions} sessions say nothing of ranks; draw {_FEWEST} or more.")
    grid, readings = layout or session_layout(robot)
    predictive = PriorPredictive(robot, grid, readings)
    predictive.require_exact(np.random.default_rng(seed))
    scaled_robot = replace(robot, prior=scaled_prior(predictive.prior, prior_factor))
    ranked: dict[str, list[dict[str, float]]] = {name: [] for name in estimators}
    failed = dict.fromkeys(estimators, 0)
    for i in range(sessions):
        rng = np.random.default_rng([seed, i])
        session = predictive.draw(rng)
        k, n = (int(rng.integers(size)) for size in predictive.fine.shape)
        for name in estimators:
            at = (k if name == "batch" else predictive.fine.shape[0] - 1, n)
            posterior = _estimated(scaled_robot, grid, session.readings, online=name == "online")
            failed[name] += not posterior.solve.converged
            ranked[name].append(_ranks(posterior, predictive, session, at))
        if progress is not None:
            progress(i + 1, sessions)
    return [
        SimulationCheck(
            name,
            rank_checks({q: np.array([r[q] for r in each]) for q in each[0]}),
            level,
            failed[name],
        )
        for name, each in ranked.items()
    ]


def _estimated(robot: Robot, grid: Grid, readings: list[Readings], *, online: bool) -> Posterior:
    """Batch posterior of all readings, or with `online` that of the smoother's last window."""
    parameters = robot.sensor_parameters
    if online:
        smoother = FixedLagSmoother(
            robot.prior, grid.arclength, sensor_parameters=parameters, gate=None
        )
        since = -np.inf
        for time in grid.time:
            for stream in readings:
                smoother.add(stream.select((stream.time > since) & (stream.time <= time)))
            smoother.advance(float(time))
            since = time
        return smoother.posterior()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EstimateWarning)
        return estimate(robot.prior, grid, readings, sensor_parameters=parameters)


def _ranks(
    posterior: Posterior, predictive: PriorPredictive, session: Session, at: tuple[int, int]
) -> dict[str, float]:
    """Ranks of the truth at a fine node, and of the sensor parameters at the nearest time node."""
    k, n = at
    fine = predictive.fine
    estimate: StateEstimate = posterior.at(fine.arclength[n], fine.time[k])
    error = session.truth.take(at).difference(
        State(estimate.pose, estimate.strain, estimate.velocity)
    )
    std = np.sqrt(np.diagonal(estimate.cov))
    out = dict(zip(QUANTITIES, ndtr(error / std).tolist(), strict=False))
    for i, name in enumerate(QUANTITIES[18:]):
        part = slice(6 * i, 6 * i + 6)
        out[name] = _rank_of_square(error[part], estimate.cov[part, part])
    row = int(np.argmin(np.abs(posterior.grid.time - fine.time[k])))
    true_row = int(np.argmin(np.abs(fine.time - posterior.grid.time[row])))
    columns = zip(predictive.process.each, predictive.process.columns, strict=True)
    for parameter, where in columns:
        values, cov = posterior.parameter(parameter.name)
        free = parameter.std > 0.0
        miss = session.parameters[true_row, where] - values[row]
        out[f"{parameter.name}"] = _rank_of_square(miss[free], cov[row][np.ix_(free, free)])
    return out


def _rank_of_square(error: Array, cov: Array) -> float:
    """Rank of an error's (r,) squared Mahalanobis norm in its χ² distribution, for cov (r, r)."""
    return float(chdtr(error.size, error @ np.linalg.solve(cov, error)))
