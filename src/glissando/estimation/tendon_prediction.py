"""Prediction from tendons alone: shape and strain with covariance along the robot, and the tip."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glissando.errors import FalseConfidenceWarning, GlissandoError
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.state import DOF
from glissando.model.tendons.equilibrium import Equilibrium
from glissando.model.tendons.replicate import Replicate
from glissando.model.tendons.statics import equilibrium
from glissando.model.tendons.tendon_rod import TendonRod, mechanical, replicated, tendon_rod
from glissando.model.tendons.tendons import Tendons

_VELOCITY = slice(12, 18)
_BEYOND = 1.5  # times the largest pull in the data from which a robot was learned
_NOTICED = 0.1  # share of the stated standard deviation by which weight may move a robot


def predict(
    robot: Robot, time: Array, displacement: Array, arclength: Array | None = None
) -> StateEstimate:
    """Predict the robot's motion from commands of its tendons alone.

    The robot is assumed in static equilibrium at every time, without external loads and weight. The
    covariance is that stated in [tendons] and [base]: errors of displacements, the unknown initial
    position of each tendon in its play, moments that the model lacks, the uncertainty of a learned
    robot's parameters, including what a marker alone left undetermined, and that of the base.

    Args:
        robot: Robot with [mechanics] and [tendons].
        time: Increasing times (M,), s.
        displacement: Displacements (M, T), positive when pulled, m.
        arclength: Arclengths (N,), m; the robot's nodes if None.

    Returns:
        States and covariances, shape (M, N); velocities from the slope of the commands.

    Raises:
        GlissandoError: Commands are impossible, or the robot lacks a table.
        NoShapeError: No equilibrium was found.

    Warns:
        FalseConfidenceWarning: The robot's weight, which is left out, bends it noticeably, or a
            tendon is pulled much farther than in the data from which it was learned.
    """
    rod, places, time, displacement = _checked(robot, time, displacement, arclength)
    shape = equilibrium(rod, displacement=rod.tendons.effective(displacement))
    node = np.searchsorted(rod.nodes, places - 1e-9)
    cov = np.zeros((len(shape.strain), len(places), DOF, DOF))
    of_shape = shape.cov(rod.tendons.std_in_play(displacement))
    cov[..., : _VELOCITY.start, : _VELOCITY.start] = of_shape[:, node]
    by_pull = shape.pose_by(shape.strain_by_displacement())[:, node]
    velocity, cov[..., _VELOCITY, _VELOCITY] = _velocity(rod, time, displacement, by_pull)
    replicates, left_open = (
        [_off(other, shape, node) for _, other in _shapes(robot, each, places, displacement, shape)]
        for each in (rod.tendons.replicates, rod.tendons.left_open)
    )
    cov[..., : _VELOCITY.start, : _VELOCITY.start] += _jackknife(replicates) + _squares(left_open)
    _warn_beyond(rod.tendons, displacement)
    prediction = StateEstimate(shape.pose()[:, node], _strain(shape, node), velocity, cov)
    warn_of_weight(robot, float(prediction.std_position.max()))
    return prediction


def _checked(
    robot: Robot, time: Array, displacement: Array, arclength: Array | None
) -> tuple[TendonRod, Array, Array, Array]:
    """Check the arguments; the rod, places (N,), times (M,) and displacements (M, T)."""
    places = robot.arclength_nodes if arclength is None else np.asarray(arclength, dtype=float)
    places, time = np.atleast_1d(places), np.atleast_1d(np.asarray(time, dtype=float))
    displacement = np.atleast_2d(np.asarray(displacement, dtype=float))
    if np.any((places < 0.0) | (places > robot.length + 1e-9)):
        raise GlissandoError(
            f"Arclengths up to {places.max():g} m leave a robot of {robot.length:g} m; ask on it."
        )
    if not len(time):
        raise GlissandoError("There are no commands of tendons; give a row for a time at least.")
    if not np.all(np.diff(time) > 0.0):
        raise GlissandoError("Times of the tendons must increase; sort the rows.")
    rod = tendon_rod(robot, places)
    wanted = time.size, len(rod.tendons)
    if displacement.shape != wanted or not np.all(np.isfinite(displacement)):
        raise GlissandoError(
            f"Displacements have shape {displacement.shape}; give {wanted}, a row a time and a "
            f"column a tendon, all finite."
        )
    return rod, places, time, displacement


def _off(other: Equilibrium, shape: Equilibrium, node: NDArray[np.intp]) -> Array:
    """Deviations (M, N, 12) of a replicate's poses and strains from the robot's at nodes (N,)."""
    turned = se3.log(se3.inverse(shape.pose()[:, node]) @ other.pose()[:, node])
    return np.concatenate([turned, _strain(other, node) - _strain(shape, node)], axis=-1)


def _strain(shape: Equilibrium, node: NDArray[np.intp]) -> Array:
    """Strains (M, N, 6) at nodes (N,): those of the pieces before them."""
    return shape.strain[:, np.maximum(node - 1, 0)]


def _shapes(
    robot: Robot,
    replicates: tuple[Replicate, ...],
    nodes: Array,
    displacement: Array,
    near: Equilibrium,
) -> Iterator[tuple[Robot, Equilibrium]]:
    """Replicates of a robot, and the equilibria of each, started at those of the robot."""
    for replicate in replicated(robot, replicates):
        rod = tendon_rod(replicate, nodes)
        pulled = rod.tendons.effective(displacement)
        yield replicate, equilibrium(rod, displacement=pulled, start=near.strain)


def _jackknife(deviations: list[Array]) -> Array:
    """Jackknife covariance (…, d, d) from the deviations (…, d) of n replicates."""
    return (len(deviations) - 1) / max(len(deviations), 1) * _squares(deviations)


def _squares(deviations: list[Array]) -> Array:
    """Sum (…, d, d) of the outer products of deviations (…, d)."""
    if not deviations:
        return np.zeros(())
    every = np.stack(deviations, axis=-1)
    return np.asarray(every @ np.swapaxes(every, -1, -2))


def _warn_beyond(tendons: Tendons, displacement: Array) -> None:
    """Warn where tendons are pulled much farther (M, T) than in the data they were learned from."""
    most = np.max(displacement, axis=0, initial=0.0)
    beyond = np.flatnonzero(most > _BEYOND * tendons.learned_to + tendons.std)
    if beyond.size:
        named = ", ".join(tendons.names[j] for j in beyond)
        j = int(beyond[np.argmax((most - tendons.learned_to)[beyond])])
        warnings.warn(
            f"Tendons are pulled farther than where this robot was learned, {named}: "
            f"{tendons.names[j]} by {1e3 * most[j]:.3g} mm, not {1e3 * tendons.learned_to[j]:.3g}. "
            f"Shapes there are less sure than they say; learn from such motions. If displacements "
            f"are in another unit, give metres (in files also millimetres, in columns named _mm).",
            FalseConfidenceWarning,
            stacklevel=3,
        )


def warn_of_weight(robot: Robot, std: float) -> None:
    """Warn where the weight in [mechanics] moves the robot by a share of the stated std.

    Args:
        robot: Robot with [mechanics] and [tendons].
        std: Standard deviation that is stated for positions, m.
    """
    prior, grid = mechanical(robot), Grid(robot.arclength_nodes, np.zeros(1))
    light = replace(prior, mechanics=replace(prior.mechanics, gravity=np.zeros(3)))
    hanging, straight = (each.rest_state(grid).pose[0, :, :3, 3] for each in (prior, light))
    sag = float(np.linalg.norm(hanging - straight, axis=1).max())
    if sag > _NOTICED * std:
        warnings.warn(
            f"The weight in [mechanics] of robot {robot.name!r}, which tendons alone do not "
            f"predict, moves it by {1e3 * sag:.2g} mm when no tendon pulls; positions are claimed "
            f"to {1e3 * std:.2g} mm. Read a sensor and estimate, or state no gravity.",
            FalseConfidenceWarning,
            stacklevel=3,
        )


def predict_tip(robot: Robot, displacement: Array, stream: str) -> tuple[Array, Array]:
    """Predict positions of a marker at the tip in the frame of its tracker.

    Args:
        robot: Robot with [mechanics] and [tendons].
        displacement: Displacements (M, T) in the order of time, positive when pulled, m.
        stream: Stream of the marker, whose sensor parameters give its mount and the tracker's
            frame.

    Returns:
        Positions (M, 3) in the tracker's frame, and covariances (M, 3, 3) of readings of these.
    """
    rod = tendon_rod(robot, np.zeros(0))
    _warn_beyond(rod.tendons, np.atleast_2d(displacement))
    shape = equilibrium(rod, displacement=rod.tendons.effective(displacement))
    marker = _marker(robot, shape, stream)
    others = _shapes(robot, rod.tendons.replicates, np.zeros(0), displacement, shape)
    off = [_marker(each, other, stream)[:, :3, 3] - marker[:, :3, 3] for each, other in others]
    lever = se3.adjoint(se3.exp(-robot.stated_transform("mount", stream)))
    turn = marker[:, :3, :3]
    cov_pose = shape.cov(rod.tendons.std_in_play(displacement))[:, -1, :6, :6]
    cov = turn @ se3.position_covariance(lever @ cov_pose @ lever.T) @ np.swapaxes(turn, 1, 2)
    noise = robot.sensor_std.get("position", np.zeros(3))
    return marker[:, :3, 3], cov + _jackknife(off) + np.diag(np.broadcast_to(noise, 3) ** 2)


def _marker(robot: Robot, shape: Equilibrium, stream: str) -> Array:
    """Poses (M, 4, 4) of a marker at the tip in the frame of its tracker."""
    mount = se3.exp(robot.stated_transform("mount", stream))
    frame = se3.exp(-robot.stated_transform("frame", stream))
    return np.asarray(frame @ shape.pose()[:, -1] @ mount)


def _velocity(
    rod: TendonRod, time: Array, displacement: Array, by_pose: Array
) -> tuple[Array, Array]:
    """Velocities (M, N, 6) from the slope of the commands, and their covariances."""
    if len(time) < 2:
        return np.zeros(by_pose.shape[:3]), np.zeros((*by_pose.shape[:2], 6, 6))
    pulled = rod.tendons.effective(displacement)
    speed = np.gradient(pulled, time, axis=0)
    combs = np.eye(3)[np.arange(len(time)) % 3]  # one of every three neighbours, for its weight
    variance = rod.tendons.std**2 * np.sum(np.gradient(combs, time, axis=0) ** 2, axis=1)
    velocity = (by_pose @ speed[:, None, :, None])[..., 0]
    return velocity, variance[:, None, None, None] * by_pose @ np.swapaxes(by_pose, -1, -2)
