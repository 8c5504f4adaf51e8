"""Readings of a rig's coils from its messages, at arclengths that follow the slides."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from glissando.hardware.capture.setup import Coil, Rig, pose_of, slide_topic
from glissando.model.robot import Robot
from glissando.model.sensors.sensors import CoilReadings
from glissando.model.slide_track import SlideMotion, SlideTrack


class CoilFrames:
    """Converts a rig's messages into coil readings as they arrive.

    Args:
        rig: The rig.
        robot: The robot, which defines the noise and the loss of coils.

    Attributes:
        counts: Frames of coils 'not seen', and frames of sliding coils that have 'no travel',
            before the first reading of their slide or more than a second after its newest one.
    """

    def __init__(self, rig: Rig, robot: Robot) -> None:
        self._rig, self._robot, self.counts = rig, robot, Counter[str]()
        self._coils = {f"/tracker/{coil.name}": coil for coil in rig.coils}
        stages = [*([""] if rig.slide else []), *(one.name for one in rig.further)]
        self._slides = {slide_topic(name): SlideTrack() for name in stages}

    def take(self, topic: str, message: dict[str, Any]) -> Iterator[CoilReadings]:
        """Yield the coil reading of a message, if any, with its time.monotonic() as time."""
        if topic in self._slides:
            self._slides[topic].add(message["time"], message["travel"])
        elif topic in self._coils:
            coil = self._coils[topic]
            slide = self._slides.get(coil.slide_topic) if coil.slides else None
            motion = SlideMotion(0.0) if slide is None else slide.at(message["time"])
            if motion is None or message["position"] is None:
                self.counts["no travel" if motion is None else "not seen"] += 1
            else:
                yield self._reading(coil, motion, message)

    def _reading(self, coil: Coil, motion: SlideMotion, message: dict[str, Any]) -> CoilReadings:
        return CoilReadings(
            time=np.array([message["time"]]),
            arclength=coil.arclengths(np.array([motion.travel]), self._robot.length),
            values=(self._rig.frame @ pose_of(message))[None],
            cov=self._robot.sensor_std["coil"] ** 2,
            loss=self._robot.sensor_loss.get("coil"),
            name=coil.name,
            channel=coil.channel,
            slide_speed=-motion.speed,
            slide_way=-motion.way,
        )
