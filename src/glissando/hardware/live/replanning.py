"""Repeated planning of a rig's slide during a live session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Self

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.capture import Rig
from glissando.hardware.capture.child_process import blocked_signals
from glissando.hardware.live.rig_source import RigSource
from glissando.hardware.live.update import Update
from glissando.model.robot import Robot
from glissando.model.slide_path import SlideLimits
from glissando.planning.path_space import path_space_of
from glissando.planning.plan_slide import Plan
from glissando.planning.planners import ProcessPlanner
from glissando.planning.replan import Replanner
from glissando.planning.sliding_sensor import sliding_sensor
from glissando.planning.zones import Zone

_COMMITTED = 0.3  # s from now within which the path is already at the stage and cannot be changed
_LEAD = 0.7  # s that the computation of the first plan may take
_FIRST = 2  # updates without a plan: a posterior of one reading leaves directions undetermined
_NODE_STEP = 0.5  # s between the time nodes of a plan
_STEP = 0.02  # s between the points of a path that is sent to the stage
_RATE = 40.0  # readings a second of the tracker
_SPEED = 0.95  # fraction of the stage's limits that plans use, so that the stage can catch up


class Replanning:
    """A sink that replans a rig's slide after each update to minimise uncertainty in zones.

    A separate process computes the plans. The stage follows each plan until the next one is ready,
    and stops at its end if none is. The path is planned for the first coil that the stage moves.

    Args:
        source: Source that reads the rig, with `steered=True`.
        rig: The devices of the rig.
        robot: The robot.
        zones: Zones of arclength, and their session times, in which uncertainty is to be small.
        horizon: Duration of each plan, s.

    Attributes:
        replanner: The plans adopted so far, and the path of the coil over time.

    Raises:
        DeviceError: The rig has no stage, no coil slides, or a zone lies off the robot.

        source = RigSource(rig, robot, path, steered=True)
        replanning = Replanning(source, rig, robot, [Zone((0.5, 0.6))])
        with LiveSession(robot, [source], [replanning]) as session: …
    """

    name, problem = "replanning", ""

    def __init__(
        self,
        source: RigSource,
        rig: Rig,
        robot: Robot,
        zones: Sequence[Zone],
        *,
        horizon: float = 5.0,
    ) -> None:
        coil = next((c for c in rig.coils if c.slides and not c.slide), None)
        if rig.stage is None or coil is None:
            raise DeviceError(
                f"{rig.name} has no stage that moves a coil, so no slide is replanned; add "
                f"[slide] to its setup file, or leave --replan out."
            )
        _require_on_robot(zones, robot)
        low, high = rig.stage.stroke
        limits = SlideLimits(high - low, _SPEED * rig.stage.speed, _SPEED * rig.stage.acceleration)
        space = path_space_of(
            limits, coil.arclength - low, coil.arclength - rig.standing_travel, horizon
        )
        self.counts, self._source, self._coil = Counter[str](), source, coil
        self._planner = ProcessPlanner[Plan]()
        self.replanner = Replanner(
            sliding_sensor(robot, rate=_RATE, name=coil.name), space, zones,
            node_step=_NODE_STEP, lead=_LEAD, planner=self._planner,
        )  # fmt: skip

    def __enter__(self) -> Self:
        with blocked_signals():
            self._planner.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self._planner.__exit__()

    def poll(self) -> None:
        """Do nothing: `send` checks for new plans."""

    def send(self, update: Update) -> None:
        """Request the next plan, and send a completed one to the stage."""
        if update.number < _FIRST:
            return
        now, last = update.ready, self.replanner.plan
        plan = self.replanner.next(update.smoother, now + _COMMITTED)
        if plan is not None and plan is not last:
            end = plan.start + self.replanner.path_space.duration
            times = np.append(np.arange(now - 1.0, end, _STEP), end)
            self._source.steer(times, self._coil.arclength - self.replanner.at(times)[0])


def _require_on_robot(zones: Sequence[Zone], robot: Robot) -> None:
    for zone in zones:
        low, high = zone.ends(np.array(zone.time or (0.0, 0.0)))
        if not (low.min() >= 0.0 and high.max() <= robot.length):
            raise DeviceError(
                f"A zone from {low.min():g} to {high.max():g} m lies off {robot.name} of "
                f"{robot.length:g} m; correct it (in metres)."
            )
