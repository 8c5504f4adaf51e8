"""A rod with tendons beside it, divided into pieces of constant strain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from glissando.errors import GlissandoError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.robot import Robot
from glissando.model.tendons.replicate import EACH, TIP, Replicate
from glissando.model.tendons.tendons import Tendons

_PIECES = 24  # for each turn of a helical tendon: the tip is right to 3e-4 of its motion


@dataclass(frozen=True)
class TendonRod:
    """A rod divided into P pieces of constant strain, with T tendons beside it.

    Attributes:
        tendons: The tendons.
        nodes: Arclengths (P+1,) where pieces meet, m.
        stiffness: Stiffness of each piece (P, 6).
        rest: Strain of each without loads (P, 6), or (M, P, 6) if each of M shapes has its own.
        base: Pose of the base (4, 4).
        var_base: Variance (6,) of the base's pose.
    """

    tendons: Tendons
    nodes: Array
    stiffness: Array
    rest: Array
    base: Array
    var_base: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def length(self) -> Array:
        """Lengths (P,) of the pieces, m."""
        return np.diff(self.nodes)

    def take(self, rows: slice) -> TendonRod:
        """The rod for some of the shapes."""
        return self if self.rest.ndim < 3 else replace(self, rest=self.rest[rows])

    @cached_property
    def middle(self) -> Array:
        """Arclengths (P,) of the middles of the pieces, m."""
        return 0.5 * (self.nodes[1:] + self.nodes[:-1])

    @cached_property
    def path(self) -> tuple[Array, Array]:
        """Positions (T, P, 3) of the tendons in the middles of the pieces, and derivatives."""
        return self.tendons.path(self.middle)

    @cached_property
    def levers(self) -> Array:
        """∂tangent/∂strain (T, P, 3, 6) of the channels."""
        place = self.path[0]
        still = np.broadcast_to(np.eye(3), (*place.shape, 3))
        return np.concatenate([still, -se3.hat3(place)], -1)

    def reaches(self, strain: Array) -> tuple[Array, Array, Array, Array]:
        """∂|tangent|/∂strain (M, T, P, 6), unit tangents, norms, 1 up to tendons' ends."""
        place, slope = self.path
        tangent = strain[:, None, :, :3] + np.cross(strain[:, None, :, 3:], place) + slope
        speed = np.linalg.norm(tangent, axis=-1)
        unit = tangent / speed[..., None]
        arm = np.cross(np.broadcast_to(place, unit.shape), unit)
        inside = (self.middle < self.tendons.end[:, None]).astype(float)
        return np.concatenate([unit, arm], axis=-1), unit, speed, inside

    def shortening(self, speed: Array) -> Array:
        """Shortening (M, T), m, from straight, of channels with tangents of norms (M, T, P)."""
        inside = self.length * (self.middle < self.tendons.end[:, None])
        straight = np.linalg.norm(STRAIGHT[:3] + self.path[1], axis=-1)
        return np.sum(inside * (straight - speed), axis=-1)


def mechanical(robot: Robot) -> MechanicalPrior:
    """Mechanical prior of a robot.

    Raises:
        GlissandoError: The robot has another prior.
    """
    if not isinstance(robot.prior, MechanicalPrior):
        raise GlissandoError(
            f"Robot {robot.name!r} has a prior of kind {robot.prior.kind!r}; what tendons do "
            f'follows from [mechanics], so give [prior] kind = "mechanical".'
        )
    return robot.prior


def tendon_rod(robot: Robot, nodes: Array | None = None) -> TendonRod:
    """The rod of a robot file with [tendons] and a mechanical prior.

    Args:
        robot: The robot.
        nodes: Arclengths at which pieces meet, m; the robot's nodes unless given. Ends of segments
            and tendons are added, and as many more as helical tendons need.

    Raises:
        GlissandoError: The robot has no tendons or another prior.
    """
    prior, tendons = mechanical(robot), robot.tendons
    if tendons is None:
        raise GlissandoError(
            f"Robot {robot.name!r} has no [tendons]; add this table to predict from tendons."
        )
    given = robot.arclength_nodes if nodes is None else nodes
    every = np.concatenate([[0.0, robot.length], given, prior.mechanics.joints, tendons.end])
    every = _refined(np.unique(np.round(every, 9)), tendons)
    middle = 0.5 * (every[1:] + every[:-1])
    stiffness = prior.mechanics.stiffness[prior.mechanics.segment(middle)]
    base = prior.base_pose, prior.var_base
    return TendonRod(tendons, every, stiffness, prior.rest.at(middle), *base)


def replicated(robot: Robot, replicates: Iterable[Replicate]) -> Iterator[Robot]:
    """Robots with the parameters of `replicates`, or of the entries of `left_open`."""
    prior, tendons = mechanical(robot), robot.tendons
    assert tendons is not None
    for replicate in replicates:
        mechanics = replace(prior.mechanics, stiffness=replicate.section_stiffness)
        numbers = {name: getattr(replicate, name) for name in (*EACH, "softness")}
        yield replace(
            robot,
            mechanics=mechanics,
            tendons=replace(tendons, replicates=(), left_open=(), **numbers),
            prior=replace(prior, mechanics=mechanics, rest_strain=replicate.rest_strain),
            sensor_parameters=tuple(
                replace(stated, value=getattr(replicate, stated.kind))
                if stated.kind in ("frame", "mount") and TIP in stated.streams
                else stated
                for stated in robot.sensor_parameters
            ),
        )


def replicate_of(robot: Robot) -> Replicate:
    """Parameters of a robot with tendons, as a replicate of another robot's."""
    prior, tendons = mechanical(robot), robot.tendons
    assert tendons is not None
    return Replicate(
        **{name: getattr(tendons, name) for name in (*EACH, "softness")},
        section_stiffness=prior.mechanics.stiffness,
        rest_strain=np.atleast_2d(prior.rest_strain),
        frame=robot.stated_transform("frame", TIP),
        mount=robot.stated_transform("mount", TIP),
    )


def _refined(nodes: Array, tendons: Tendons) -> Array:
    """Nodes with as many added as pieces need on which helical tendons hardly turn."""
    turns = np.diff(nodes) * np.max(1.0 / np.abs(tendons.pitch))
    counts = np.maximum(1, np.ceil(_PIECES * turns - 1e-9)).astype(int)
    between = zip(nodes[:-1], nodes[1:], counts, strict=True)
    return np.append(
        np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in between]), nodes[-1]
    )
