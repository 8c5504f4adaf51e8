"""Learn a tendon robot from displacements of its tendons and positions of a marker at its tip.

The robot's parameters are estimated by robust least squares with a prior at the initial robot file.
Derivatives are those of the equilibrium, so a step costs one solution per shape. The model error is
estimated by cross-validation: each block of the recording is predicted from the others. The spread
of the parameters without each block is their uncertainty; for directions that the marker does not
observe, such as a rotation of its tracker against a rod bent at rest, the prior is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from glissando.calibration.robot.tendon_numbers import Numbers, TendonModel
from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.model.quantiles import chi_square_quantile
from glissando.model.robot import Robot
from glissando.model.tendons.equilibrium import Equilibrium

_TAILS = 4.0  # degrees of freedom of Student's t: tendons slip and are adjusted
_SCALE = 0.02  # of the robot's length: standard deviation of errors in the fit
_BLOCKS, _RUNS = 6, 36  # blocks of a recording; time intervals dealt to them if patterns are few
_AT_REST, _IDLE = 0.2, 0.3  # of the largest displacement: threshold of a row, and of a tendon
_MOST = 700  # largest number of rows in a fit
_STEPS = 25
_ENOUGH = 0.5  # decrease of the cost, actual and predicted, below which the iteration ends
_GIVE_UP = 1e6  # damping at which the iteration ends
_FAR = 30.0  # ratio of actual to predicted motion of the tip that indicates another unit
_SHAPES, _NUDGE = 24, 1e-2  # shapes at which motion of the robot is compared; step of differences
_EXPLAINED = 0.999  # share of the squared motion that the kept directions explain
_COVERED, _ELLIPSOID = 0.96, 0.95  # coverage is higher, as future motions combine more patterns

Watch = Callable[[str], None]


@dataclass(frozen=True)
class TendonData:
    """Displacements of tendons and positions of the marker at the tip.

    Attributes:
        displacement: Displacements (M, T) in the order of time, positive when pulled, m.
        tip: Positions (M, 3) of the marker in the frame of its tracker, m.
        block: Block number of each row (M,) for cross-validation.
    """

    displacement: Array
    tip: Array
    block: NDArray[np.intp]

    @staticmethod
    def of(displacement: Array, tip: Array, block: NDArray[np.intp] | None = None) -> TendonData:
        """Check data; without `block`, rows are grouped by similar displacements into six blocks.

        Raises:
            RecordingError: The numbers of rows differ, or are too small.
        """
        if len(displacement) != len(tip) or len(tip) < 10 * _BLOCKS:
            raise RecordingError(
                f"{len(displacement)} rows of tendons and {len(tip)} of the tip; give as many of "
                f"both, {10 * _BLOCKS} at least."
            )
        return TendonData(displacement, tip, _blocks(displacement) if block is None else block)


@dataclass(frozen=True)
class LearnedTendons:
    """A learned tendon robot.

    Attributes:
        robot: The robot, with its model error.
        rmse: Root mean square error of the tip (m), fitted to all blocks.
        held_out_rmse: Root mean square error of the blocks (m), each predicted from the others.
        held_out: Errors (M, 3) of the blocks, each predicted from the others, m.
    """

    robot: Robot
    rmse: float
    held_out_rmse: float
    held_out: Array


def learn_tendons(robot: Robot, data: TendonData, watch: Watch | None = None) -> LearnedTendons:
    """Learn stiffness, rest shape, channels, slack, elasticity, play and the model error.

    Args:
        robot: Initial robot with [mechanics] and [tendons]; the sensor parameters of kind frame and
            mount of its stream "tip" are the prior means for the marker and its tracker.
        data: Displacements and positions.
        watch: Called with a sentence after each step.

    Raises:
        RecordingError: The recording has another number of tendons than the robot, or the scale of
            the tip's motion indicates another unit.
    """
    model = _with_best_rotation(TendonModel.of(robot, data.displacement.shape[1]), data)
    _require_unit(model, data)
    say = watch or (lambda text: None)
    all_rows = np.ones(len(data.tip), dtype=bool)
    numbers = _fit(model, model.start(), data, all_rows, "from all rows", say)
    error = _errors(model, numbers, data)
    held_out, without_block = np.empty_like(error), []
    for block in np.unique(data.block):
        held_rows = data.block == block
        without_block.append(_fit(model, numbers, data, ~held_rows, f"without block {block}", say))
        held_out[held_rows] = _errors(model, without_block[-1], data)[held_rows]
    model_error = _model_error(model, numbers, data, held_out)
    learned = model.robot_of(
        numbers, model_error, without_block, _left_to_prior(model, numbers, data)
    )
    assert learned.tendons is not None
    most = np.maximum(data.displacement.max(axis=0), 0.0)
    learned = replace(learned, tendons=replace(learned.tendons, learned_to=most))
    rmse, held_out_rmse = (float(np.sqrt(np.mean(np.sum(e**2, axis=1)))) for e in (error, held_out))
    return LearnedTendons(learned, rmse, held_out_rmse, held_out)


def _blocks(displacement: Array) -> NDArray[np.intp]:
    """Block numbers (M,), of six blocks; rows that move the same tendons the same way share one.

    Rows near rest join the block before. With few patterns, blocks are interleaved time intervals.
    """
    size = np.abs(displacement).max(axis=1)
    moved = size > _AT_REST * np.quantile(size, 0.95)
    pulled = np.abs(displacement) > _IDLE * size[:, None]
    ways = (np.sign(displacement) * pulled).astype(int)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(size)), int(np.argmax(moved))))
    number: dict[tuple[int, ...], int] = {}
    pattern = np.array([number.setdefault(tuple(ways[k]), len(number)) for k in last.tolist()])
    if len(number) < _BLOCKS:
        return np.arange(len(size)) * _RUNS // len(size) % _BLOCKS
    return pattern % _BLOCKS


def _errors(model: TendonModel, numbers: Numbers, data: TendonData) -> Array:
    """Measured minus predicted positions (M, 3) in the tracker's frame."""
    return data.tip - model.tip(numbers, model.reached(numbers, data.displacement))[0]


def spread(positions: Array) -> float:
    """RMS distance (m) of positions (M, 3) from their mean."""
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))


def _require_unit(model: TendonModel, data: TendonData) -> None:
    """Raise RecordingError if the tip moves `_FAR` times more or less than predicted."""
    moved, predicted = spread(data.tip), spread(data.tip - _errors(model, model.start(), data))
    if not predicted / _FAR < moved < predicted * _FAR:
        raise RecordingError(
            f"The tip moves by {1e3 * moved:.3g} mm (RMS), where these displacements move a robot "
            f"of this file by {1e3 * predicted:.3g} mm; give positions and displacements in the "
            f"units that the recording says, and stiffness in N m²."
        )


def _with_best_rotation(model: TendonModel, data: TendonData) -> TendonModel:
    """Model with the best of twelve rotations of the tracker about the robot's axis."""
    rows = np.unique(np.linspace(0, len(data.tip) - 1, 100).astype(int))
    few = replace(data, displacement=data.displacement[rows], tip=data.tip[rows])
    turns = [model.turned(angle) for angle in np.arange(12) * np.pi / 6.0]
    misses = [np.linalg.norm(_errors(turn, turn.start(), few), axis=1).sum() for turn in turns]
    return turns[int(np.argmin(misses))]


def _fit(
    model: TendonModel, start: Numbers, data: TendonData, use: Array, name: str, say: Watch
) -> Numbers:
    """Fit the rows `use` by Levenberg–Marquardt, with Student's t errors of the tip and a prior."""
    rows = _strided(np.flatnonzero(use), _MOST)
    sigma, info_prior = _SCALE * model.robot.length, model.std**-2.0

    def cost_of(numbers: Numbers, strain: Array | None) -> tuple[float, Array, Equilibrium]:
        pulled = model.reached(numbers, data.displacement)[rows]
        result, shape = model.tip(numbers, pulled, strain)
        error = (data.tip[rows] - result) / sigma
        tails = np.log1p(np.sum(error**2, axis=1) / _TAILS)
        cost = 0.5 * (_TAILS + 3.0) * np.sum(tails) + 0.5 * np.sum(info_prior * numbers**2)
        return float(cost), error, shape

    numbers, damping = start, 1e-2
    cost, error, shape = cost_of(numbers, None)
    for step in range(_STEPS):
        info, rhs = _normal_equations(model, numbers, data, rows, (error, shape))
        before, predicted = cost, 0.5 * float(rhs @ np.linalg.solve(info, rhs))
        while damping < _GIVE_UP:
            trial = numbers + np.linalg.solve(info + damping * np.diag(np.diag(info)), rhs)
            result = cost_of(trial, shape.strain)
            if result[0] < cost:
                numbers, (cost, error, shape) = trial, result
                damping = max(damping / 5.0, 1e-6)
                break
            damping *= 4.0
        rmse = sigma * np.sqrt(np.mean(np.sum(error**2, axis=1)))
        say(f"learning {name}: step {step + 1}, tip within {1e3 * rmse:.2f} mm")
        if damping >= _GIVE_UP or max(before - cost, predicted) < _ENOUGH:
            break
    return numbers


def _strided(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Rows at a regular stride, `most` at most."""
    return rows[:: max(1, -(-len(rows) // most))]


def _normal_equations(
    model: TendonModel,
    numbers: Numbers,
    data: TendonData,
    rows: NDArray[np.intp],
    at: tuple[Array, Equilibrium],
) -> tuple[Array, Array]:
    """Information (n, n) and right-hand side (n,), given scaled errors and shapes `at` of rows."""
    error, shape = at
    slope = model.slope(numbers, data.displacement, rows, shape) / (_SCALE * model.robot.length)
    root = np.sqrt((_TAILS + 3.0) / (_TAILS + np.sum(error**2, axis=1)))[:, None, None]
    tall = (slope * root).reshape(-1, slope.shape[-1])
    prior = model.std**-2.0
    rhs = tall.T @ (error * root[..., 0]).ravel() - prior * numbers
    return tall.T @ tall + np.diag(prior), rhs


def _left_to_prior(model: TendonModel, numbers: Numbers, data: TendonData) -> list[Numbers]:
    """Numbers displaced by one standard deviation along each direction left to the prior.

    A change Δ of the prior's mean changes the numbers by A⁻¹ P⁻¹ Δ, with A the information and P
    the prior's covariance. The directions that move the robot most in its own frame are kept; those
    of the marker and its tracker do not move it.
    """
    rows = _strided(np.arange(len(data.tip)), _MOST)
    tip, shape = model.tip(numbers, model.reached(numbers, data.displacement)[rows])
    error = (data.tip[rows] - tip) / (_SCALE * model.robot.length)
    info, _ = _normal_equations(model, numbers, data, rows, (error, shape))
    directions = np.linalg.solve(info, np.diag(1.0 / model.std))
    few = _strided(np.arange(len(rows)), _SHAPES)

    def body(moved: Numbers) -> Array:
        """Flattened positions of the ends of pieces, in the robot's own frame."""
        pulled = model.reached(moved, data.displacement)[rows[few]]
        return model.shapes(moved, pulled, shape.strain[few]).pose()[..., :3, 3].ravel()

    ends = [[body(numbers + _NUDGE * step) for step in (way, -way)] for way in directions.T]
    moved = np.array([(ahead - behind) / (2.0 * _NUDGE) for ahead, behind in ends])
    across, size, _ = np.linalg.svd(moved, full_matrices=False)
    share = np.cumsum(size**2) / np.sum(size**2)
    return list(numbers + (directions @ across[:, : 1 + np.searchsorted(share, _EXPLAINED)]).T)


def _model_error(model: TendonModel, numbers: Numbers, data: TendonData, error: Array) -> Array:
    """Model error (3,) from cross-validation errors (M, 3) of the tip.

    Its parts (displacements, missing moments, marker) maximise the likelihood of the errors under
    Student's t; all are then scaled so that 96 % of the errors lie inside their 95 % ellipsoid.
    """
    parts = np.stack(model.error_parts(numbers, data.displacement))
    size = np.sqrt(np.einsum("cmii->c", parts) / len(error))
    total = np.sqrt(np.mean(np.sum(error**2, axis=1)))

    def squares(logs: Array) -> tuple[Array, Array]:
        cov = np.einsum("c,cmij->mij", np.exp(2.0 * logs), parts)
        white = np.linalg.solve(np.linalg.cholesky(cov), error[..., None])[..., 0]
        return np.sum(white**2, axis=1), np.linalg.slogdet(cov)[1]

    def cost(logs: Array) -> float:
        square, log_det = squares(logs)
        tails = 0.5 * (_TAILS + 3.0) * np.log1p(square / _TAILS) + 0.5 * log_det
        return float(np.mean(tails) + 1e-3 * np.sum((logs - start) ** 2))

    start = np.log(total / size / np.sqrt(len(parts)))
    logs = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 300}).x
    inside = np.quantile(squares(logs)[0], _COVERED) / chi_square_quantile(_ELLIPSOID, 3)
    return np.asarray(np.exp(logs) * np.sqrt(inside))
