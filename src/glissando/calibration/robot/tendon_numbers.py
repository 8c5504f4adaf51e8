"""Learned parameters of a tendon robot: their meaning, prior and Jacobian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from glissando.errors import RecordingError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.tendons.equilibrium import Equilibrium
from glissando.model.tendons.replicate import TIP
from glissando.model.tendons.statics import equilibrium, misfit
from glissando.model.tendons.tendon_rod import TendonRod, mechanical, replicate_of, tendon_rod
from glissando.model.tendons.tendons import Tendons

Numbers: TypeAlias = Array
"""Vector (n,) of all learned parameters of a model, relative to the initial robot file."""

_NUDGE = 1e-5
_BENDING, _EXTENSION = slice(3, 5), 2
_MARKER = ("frame turn", "frame shift", "mount")


@dataclass(frozen=True)
class TendonModel:
    """Parametrisation of a tendon robot about an initial robot file.

    Attributes:
        robot: Initial robot.
        rod: Initial robot in pieces, cut at its segments, or at its nodes if a channel is helical.
        segment: Segment (P,) of each piece.
        frame: Prior mean of the world's pose in the tracker's frame (4, 4).
        mount: Prior mean of the marker's pose in the frame of the tip (4, 4).
        where: Slice of the numbers of each name.
        std: Prior standard deviations (n,) of the numbers, whose prior mean is zero.
    """

    robot: Robot
    rod: TendonRod
    segment: NDArray[np.intp]
    frame: Array
    mount: Array
    where: dict[str, slice]
    std: Array

    @staticmethod
    def of(robot: Robot, columns: int) -> TendonModel:
        """Model of a robot for recordings with displacements of `columns` tendons.

        Raises:
            RecordingError: The robot has another number of tendons.
        """
        rod = tendon_rod(robot, np.zeros(0))
        tendons, mechanics = rod.tendons, mechanical(robot).mechanics
        if len(tendons) != columns:
            raise RecordingError(
                f"The recording has {columns} tendons and robot {robot.name!r} {len(tendons)}; "
                f"correct [tendons] of the robot file."
            )
        prior = _prior(tendons, len(mechanics.stiffness), robot.length)
        ends = np.cumsum([0, *(value.size for value in prior.values())])
        where = {name: slice(ends[i], ends[i + 1]) for i, name in enumerate(prior)}
        frame = se3.inverse(se3.exp(robot.stated_transform("frame", TIP)))
        mount = se3.exp(robot.stated_transform("mount", TIP))
        segment = mechanics.segment(rod.middle)
        return TendonModel(
            robot, rod, segment, frame, mount, where, np.concatenate(list(prior.values()))
        )

    def start(self) -> Numbers:
        """Numbers (n,) of the initial robot: zeros."""
        return np.zeros(self.std.size)

    def turned(self, angle: float) -> TendonModel:
        """Model whose tracker's prior mean is rotated by an angle about the robot's axis, rad."""
        turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, angle]))
        return replace(self, frame=self.frame @ turn)

    def tendons(self, numbers: Numbers) -> Tendons:
        """Tendons with the parameters `numbers`."""
        part, before = self._part(numbers), self.rod.tendons
        ends = np.unique(before.end, return_inverse=True)[1]
        return replace(
            before,
            angle=before.angle + part("angle"),
            radius=before.radius * np.exp(part("radius") + part("every radius")),
            slack=before.slack + part("slack") + part("every slack"),
            stiffness=before.stiffness * np.exp(part("elasticity")),
            softness=before.softness * float(np.exp(part("softness")[0])),
            play=before.play * np.exp(part("play"))[ends],
        )

    def rod_of(self, numbers: Numbers) -> TendonRod:
        """Rod with the parameters `numbers`."""
        part = self._part(numbers)
        stiffness, rest = self.rod.stiffness.copy(), self.rod.rest.copy()
        stiffness[:, _BENDING] *= np.exp(part("bending"))[self.segment, None]
        stiffness[:, _EXTENSION] *= np.exp(part("extension")[0])
        bend = part("rest").reshape(-1, 2) / self._segment_lengths()[:, None]
        rest[:, _BENDING] += bend[self.segment]
        return replace(self.rod, tendons=self.tendons(numbers), stiffness=stiffness, rest=rest)

    def robot_of(
        self,
        numbers: Numbers,
        errors: Array,
        without: Sequence[Numbers] = (),
        left_open: Sequence[Numbers] = (),
    ) -> Robot:
        """Robot with the parameters `numbers`.

        Args:
            numbers: Parameters (n,).
            errors: Standard deviation of displacements (m), root density of missing moments
                (N m^3/2) and standard deviation of the marker's position (m).
            without: Parameters (n,) learned without each block of the recording.
            left_open: Parameters (n,) displaced along each direction left to the prior.
        """
        part, robot = self._part(numbers), self.robot
        before = mechanical(robot)
        stiffness = before.mechanics.stiffness.copy()
        stiffness[:, _BENDING] *= np.exp(part("bending"))[:, None]
        stiffness[:, _EXTENSION] *= np.exp(part("extension")[0])
        rest = before.rest.at(np.array([0.0, *before.mechanics.joints]))
        rest[:, _BENDING] += part("rest").reshape(-1, 2) / self._segment_lengths()[:, None]
        mechanics = replace(before.mechanics, stiffness=stiffness)
        prior = replace(before, mechanics=mechanics, rest_strain=rest)
        std, moment, marker = errors
        replicates, others = (
            tuple(replicate_of(self.robot_of(each, errors)) for each in some)
            for some in (without, left_open)
        )
        tendons = replace(
            self.tendons(numbers),
            std=float(std),
            psd_moment=float(moment**2),
            replicates=replicates,
            left_open=others,
        )
        frame, mount = self._marker(numbers)
        known = [
            SensorParameter(f"{TIP} {kind}", kind, (TIP,), value, np.zeros(6))
            for kind, value in (("frame", se3.log(se3.inverse(frame))), ("mount", se3.log(mount)))
        ]
        other_parameters = [p for p in robot.sensor_parameters if TIP not in p.streams]
        return replace(
            robot,
            mechanics=mechanics,
            tendons=tendons,
            prior=prior,
            sensor_std=robot.sensor_std | {"position": np.full(3, float(marker))},
            sensor_parameters=(*other_parameters, *known),
        )

    def reached(self, numbers: Numbers, displacement: Array) -> Array:
        """Effective displacements (M, T) after play, of displacements in the order of time."""
        return self.tendons(numbers).effective(displacement)

    def shapes(self, numbers: Numbers, pulled: Array, start: Array | None = None) -> Equilibrium:
        """Equilibrium shapes (M,) of the robot with the parameters `numbers`.

        Args:
            numbers: Parameters (n,).
            pulled: Effective displacements (M, T) after play, m.
            start: Initial guess (M, P, 6) of the strains, or None.
        """
        return equilibrium(self.rod_of(numbers), displacement=pulled, start=start)

    def tip(
        self, numbers: Numbers, pulled: Array, start: Array | None = None
    ) -> tuple[Array, Equilibrium]:
        """Positions (M, 3) of the marker in the tracker's frame, and the equilibrium shapes."""
        shape = self.shapes(numbers, pulled, start)
        return self._marker_positions(numbers, shape.pose()[:, -1]), shape

    def slope(
        self, numbers: Numbers, displacement: Array, rows: NDArray[np.intp], at: Equilibrium
    ) -> Array:
        """Jacobian ∂tip/∂numbers (R, 3, n) at the shapes (R,) of some rows.

        Args:
            numbers: Parameters (n,).
            displacement: Displacements (M, T) of all rows before play, m.
            rows: Indices (R,) of the rows.
            at: Equilibrium shapes (R,) of these rows.
        """
        tip, out = at.pose()[:, -1], np.zeros((len(rows), 3, numbers.size))
        by_wrench, by_tension = self._responses(numbers, at)
        effective = self.reached(numbers, displacement)[rows]
        for name, columns in self.where.items():
            for i in range(columns.start, columns.stop):
                ends = []
                for sign in (1.0, -1.0):
                    moved = numbers.copy()
                    moved[i] += sign * _NUDGE * self.std[i]
                    if name in _MARKER:
                        ends.append(self._marker_positions(moved, tip))
                        continue
                    pulled = effective
                    if name == "play":
                        pulled = self.reached(moved, displacement)[rows]
                    wrench, tension = misfit(self.rod_of(moved), at.strain, at.tension, pulled)
                    ends.append(
                        np.einsum("mapi,mpi->ma", by_wrench, wrench)
                        + (by_tension @ tension[..., None])[..., 0]
                    )
                out[:, :, i] = (ends[0] - ends[1]) / (2.0 * _NUDGE * self.std[i])
        return out

    def error_parts(self, numbers: Numbers, displacement: Array) -> tuple[Array, Array, Array]:
        """Covariances (M, 3, 3) of the tip by unit model errors.

        The parts are 1 m of displacements, 1 N m^3/2 of missing moments and 1 m of the marker.
        """
        _, at = self.tip(numbers, self.reached(numbers, displacement))
        turn = self._marker_jacobian(numbers, at)
        slopes = at.pose_by(at.strain_by_displacement()), at.pose_by_moment()
        by_pull, by_moment = (turn @ slope[:, -1] for slope in slopes)
        marker = np.broadcast_to(np.eye(3), (len(turn), 3, 3))
        pull, bend = (by @ np.swapaxes(by, 1, 2) for by in (by_pull, by_moment))
        return pull, bend, marker

    def _part(self, numbers: Numbers) -> Callable[[str], Array]:
        return lambda name: numbers[self.where[name]]

    def _segment_lengths(self) -> Array:
        return np.diff([0.0, *mechanical(self.robot).mechanics.joints, self.robot.length])

    def _marker(self, numbers: Numbers) -> tuple[Array, Array]:
        """Poses (4, 4) of the world in the tracker's frame, and of the marker in the tip's."""
        part, frame, mount = self._part(numbers), self.frame.copy(), self.mount.copy()
        frame[:3, :3] = frame[:3, :3] @ se3.so3_exp(part("frame turn"))
        frame[:3, 3] += part("frame shift")
        mount[:3, 3] += part("mount")
        return frame, mount

    def _marker_positions(self, numbers: Numbers, tip: Array) -> Array:
        """Positions (M, 3) of the marker in the tracker's frame, for poses (M, 4, 4) of the tip."""
        frame, mount = self._marker(numbers)
        return np.asarray((frame @ tip @ mount)[:, :3, 3])

    def _marker_jacobian(self, numbers: Numbers, at: Equilibrium) -> Array:
        """Jacobian ∂marker/∂(pose of the tip) (M, 3, 6)."""
        frame, mount = self._marker(numbers)
        turn = frame[:3, :3] @ at.pose()[:, -1, :3, :3]
        return np.concatenate([turn, -turn @ se3.hat3(mount[:3, 3])], axis=-1)

    def _responses(self, numbers: Numbers, at: Equilibrium) -> tuple[Array, Array]:
        """Derivatives of the tip by residuals of the equilibrium: wrench and tension.

        ∂tip/∂wrench is (M, 3, P, 6), ∂tip/∂tension (M, 3, T).
        """
        turn = self._marker_jacobian(numbers, at)
        by_wrench, by_tension = (turn @ at.pose_by(slope)[:, -1] for slope in at.responses())
        return by_wrench.reshape(len(turn), 3, -1, 6), by_tension


def _prior(tendons: Tendons, segments: int, length: float) -> dict[str, Array]:
    """Prior standard deviations of the numbers by name, from tolerances of manufacture."""
    radius, count = float(np.mean(tendons.radius)), len(tendons)
    return {
        "angle": np.full(count, np.deg2rad(4.0)),
        "radius": np.full(count, 0.03),
        "every radius": np.full(1, 0.1),
        "slack": np.full(count, 0.15 * radius),
        "every slack": np.full(1, 0.45 * radius),
        "elasticity": np.full(count, 0.3),
        "bending": np.full(segments, 1.0),
        "extension": np.full(1, 1.0),
        "softness": np.full(1, 0.7),
        "play": np.full(np.unique(tendons.end).size, 1.0),
        "rest": np.full(2 * segments, 0.1),
        "frame turn": np.array([0.1, 0.1, 0.3]),
        "frame shift": np.full(3, 0.025 * length),
        "mount": np.full(3, 0.015 * length),
    }
