"""The robot's shape in a browser while it is recorded: an online estimator in its own process.

A process and not a thread: estimating would keep the recording's threads from the devices for tens
of milliseconds at a time, and a servo that is not heard stops.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from glissando.errors import GlissandoError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.capture.setup import Coil, Rig
from glissando.io.robot_file import Robot, load_robot, robot_file
from glissando.model.sensors.sensors import CoilReadings
from glissando.visualization.page.live import Live, follow

_END = 10.0  # s that the process may take to end

Hear = Callable[[str, dict[str, Any]], None]
"""Called with the topic and the message after each is logged, and must not wait."""


@contextmanager
def followed(rig: Rig) -> Iterator[tuple[str, Hear]]:
    """The address to look at, and what is to hear the rig's messages.

    Raises GlissandoError when viser is not installed, or the robot's file states no coil's noise.
    """
    robot = load_robot(robot_file(rig.robot))
    if "coil" not in robot.sensor_std:
        raise GlissandoError(f"Robot {robot.name!r} states no noise of coils; add [sensors.coil].")
    context = multiprocessing.get_context("spawn")
    messages, address = context.Queue(), context.SimpleQueue()
    process = context.Process(target=_work, args=(rig, messages, address), daemon=True)
    process.start()
    try:
        while address.empty():
            if not process.is_alive():
                raise GlissandoError(
                    "The live view did not start; try pip install 'glissando[view]'."
                )
            time.sleep(0.05)
        yield str(address.get()), lambda topic, message: messages.put((topic, message))
    finally:
        messages.put(None)
        process.join(_END)
        if process.is_alive():
            process.terminate()
        messages.cancel_join_thread()


def _work(rig: Rig, messages: Any, address: Any) -> None:
    robot = load_robot(robot_file(rig.robot))
    coils = {f"/tracker/{c.name}": c for c in rig.coils}
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, sensor_parameters=robot.sensor_parameters
    )
    step, due, travel = 1.0 / robot.time_rate, -np.inf, np.zeros(1)
    with Live(np.linspace(0.0, robot.length, 41)) as live:
        address.put(live.address)
        while (item := messages.get()) is not None:
            topic, message = item
            if topic == "/slide":
                travel = np.array([message["travel"]])
            elif topic in coils and message["position"] is not None:
                smoother.add(_reading(rig, robot, coils[topic], message, travel))
                if message["time"] >= due and messages.empty():  # else behind: catch up first
                    smoother.advance(message["time"])
                    due = message["time"] + step
                    follow(live, smoother)


def _reading(
    rig: Rig, robot: Robot, coil: Coil, message: dict[str, Any], travel: Array
) -> CoilReadings:
    pose = np.eye(4)
    pose[:3, :3] = se3.rotation_from_quaternion(np.array(message["quaternion"]))
    pose[:3, 3] = message["position"]
    return CoilReadings(
        time=np.array([message["time"]]),
        arclength=np.clip(coil.places(travel), 0.0, robot.length),
        values=(rig.frame @ pose)[None],
        cov=robot.sensor_std["coil"] ** 2,
        name=coil.name,
    )
