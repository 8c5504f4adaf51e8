"""The numbers of a tendon robot that are learned: what they mean, their prior, their slopes."""

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
"""All numbers of a model as one vector: how far each is from the robot file."""

_NUDGE = 1e-5
_BENDING, _EXTENSION = slice(3, 5), 2
_MARKER = ("frame turn", "frame shift", "mount")


@dataclass(frozen=True)
class TendonModel:
    """What is learned of a robot, and where it starts.

    Attributes:
        robot: The robot to start from.
        rod: It cut at its segments, or at its nodes if a channel is helical.
        segment: Segment (P,) of each piece.
        frame: Pose of the world in the tracker's frame (4, 4), as expected.
        mount: Pose of the marker in the frame of the tip (4, 4), as expected.
        where: Which numbers each name has.
        std: Standard deviations of the numbers about the start.
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
        """The model of a robot file for recordings with so many tendons.

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
        """The numbers of the robot file."""
        return np.zeros(self.std.size)

    def turned(self, angle: float) -> TendonModel:
        """The model whose tracker is expected turned by an angle about the robot's axis."""
        turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, angle]))
        return replace(self, frame=self.frame @ turn)

    def tendons(self, numbers: Numbers) -> Tendons:
        """The tendons that the numbers describe."""
        of, before = self._part(numbers), self.rod.tendons
        ends = np.unique(before.end, return_inverse=True)[1]
        return replace(
            before,
            angle=before.angle + of("angle"),
            radius=before.radius * np.exp(of("radius") + of("every radius")),
            slack=before.slack + of("slack") + of("every slack"),
            stiffness=before.stiffness * np.exp(of("elasticity")),
            softness=before.softness * float(np.exp(of("softness")[0])),
            play=before.play * np.exp(of("play"))[ends],
        )

    def rod_of(self, numbers: Numbers) -> TendonRod:
        """The rod that the numbers describe."""
        of = self._part(numbers)
        stiffness, rest = self.rod.stiffness.copy(), self.rod.rest.copy()
        stiffness[:, _BENDING] *= np.exp(of("bending"))[self.segment, None]
        stiffness[:, _EXTENSION] *= np.exp(of("extension")[0])
        bend = of("rest").reshape(-1, 2) / self._segment_lengths()[:, None]
        rest[:, _BENDING] += bend[self.segment]
        return replace(self.rod, tendons=self.tendons(numbers), stiffness=stiffness, rest=rest)

    def robot_of(
        self,
        numbers: Numbers,
        errors: Array,
        without: Sequence[Numbers] = (),
        left_open: Sequence[Numbers] = (),
    ) -> Robot:
        """The robot that the numbers describe.

        Args:
            numbers: The numbers.
            errors: Standard deviation of displacements (m), root density of missing moments
                (N m^3/2) and standard deviation of the marker's position (m).
            without: The numbers without each part of what they were learned from.
            left_open: The numbers moved along what was left to the prior.
        """
        of, robot = self._part(numbers), self.robot
        before = mechanical(robot)
        stiffness = before.mechanics.stiffness.copy()
        stiffness[:, _BENDING] *= np.exp(of("bending"))[:, None]
        stiffness[:, _EXTENSION] *= np.exp(of("extension")[0])
        rest = before.rest.at(np.array([0.0, *before.mechanics.joints]))
        rest[:, _BENDING] += of("rest").reshape(-1, 2) / self._segment_lengths()[:, None]
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
        elsewhere = [p for p in robot.sensor_parameters if TIP not in p.streams]
        return replace(
            robot,
            mechanics=mechanics,
            tendons=tendons,
            prior=prior,
            sensor_std=robot.sensor_std | {"position": np.full(3, float(marker))},
            sensor_parameters=(*elsewhere, *known),
        )

    def reached(self, numbers: Numbers, displacement: Array) -> Array:
        """Displacements (M, T), in the order of time, less the play."""
        return self.tendons(numbers).effective(displacement)

    def shapes(self, numbers: Numbers, pulled: Array, start: Array | None = None) -> Equilibrium:
        """The shapes (M,) of the robot that the numbers describe.

        Args:
            numbers: The numbers.
            pulled: Displacements (M, T) less the play.
            start: Strains (M, P, 6) near those of the shapes.
        """
        return equilibrium(self.rod_of(numbers), displacement=pulled, start=start)

    def tip(
        self, numbers: Numbers, pulled: Array, start: Array | None = None
    ) -> tuple[Array, Equilibrium]:
        """Positions (M, 3) of the marker in the tracker's frame, and the `shapes`."""
        shape = self.shapes(numbers, pulled, start)
        return self._seen(numbers, shape.pose()[:, -1]), shape

    def slope(
        self, numbers: Numbers, displacement: Array, rows: NDArray[np.intp], at: Equilibrium
    ) -> Array:
        """∂tip/∂numbers (R, 3, numbers) at the shapes (R,) of some rows.

        Args:
            numbers: The numbers.
            displacement: Displacements (M, T) of all rows, play included.
            rows: Which rows.
            at: Their shapes.
        """
        tip, out = at.pose()[:, -1], np.zeros((len(rows), 3, numbers.size))
        by_wrench, by_tension = self._responses(numbers, at)
        usual = self.reached(numbers, displacement)[rows]
        for name, columns in self.where.items():
            for i in range(columns.start, columns.stop):
                ends = []
                for sign in (1.0, -1.0):
                    moved = numbers.copy()
                    moved[i] += sign * _NUDGE * self.std[i]
                    if name in _MARKER:
                        ends.append(self._seen(moved, tip))
                        continue
                    pulled = usual
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
        """Covariances (M, 3, 3) of the tip by a metre of displacement, unit moments, a metre."""
        _, at = self.tip(numbers, self.reached(numbers, displacement))
        turn = self._turn(numbers, at)
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
        """Poses (4, 4) of the world in the tracker's frame, and of the marker at the tip."""
        of, frame, mount = self._part(numbers), self.frame.copy(), self.mount.copy()
        frame[:3, :3] = frame[:3, :3] @ se3.so3_exp(of("frame turn"))
        frame[:3, 3] += of("frame shift")
        mount[:3, 3] += of("mount")
        return frame, mount

    def _seen(self, numbers: Numbers, tip: Array) -> Array:
        """Positions (M, 3) of the marker for poses (M, 4, 4) of the tip, tracker's frame."""
        frame, mount = self._marker(numbers)
        return np.asarray((frame @ tip @ mount)[:, :3, 3])

    def _turn(self, numbers: Numbers, at: Equilibrium) -> Array:
        """∂marker/∂(pose of the tip) (M, 3, 6)."""
        frame, mount = self._marker(numbers)
        turn = frame[:3, :3] @ at.pose()[:, -1, :3, :3]
        return np.concatenate([turn, -turn @ se3.hat3(mount[:3, 3])], axis=-1)

    def _responses(self, numbers: Numbers, at: Equilibrium) -> tuple[Array, Array]:
        """∂tip/∂wrench (M, 3, P, 6) left over, and ∂tip/∂tension (M, 3, T) of a misfit.

        The adjoint of the equilibrium: what a change of its equations does to the tip.
        """
        turn = self._turn(numbers, at)
        by_wrench, by_tension = (turn @ at.pose_by(slope)[:, -1] for slope in at.responses())
        return by_wrench.reshape(len(turn), 3, -1, 6), by_tension


def _prior(tendons: Tendons, segments: int, length: float) -> dict[str, Array]:
    """Standard deviations of the numbers by name: what a workshop leaves open."""
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
