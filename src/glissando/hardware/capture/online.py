"""The robot's shape estimated and displayed during recording, in a separate process.

An estimator in a thread would hold the interpreter lock for tens of milliseconds at a time, and a
moving servo stops if it receives no command for too long.
"""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar

import numpy as np

from glissando.errors import GlissandoError, UnreachableError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.geometry.se3 import Array
from glissando.hardware.capture.child_process import blocked_signals, end_with_parent
from glissando.hardware.capture.coil_frames import CoilFrames
from glissando.hardware.capture.setup import Rig
from glissando.io.robot_file import load_robot
from glissando.io.shipped_robots import robot_file

_POINTS = 41  # points along the robot that are displayed
_END = 10.0  # s allowed for the process to end

OnMessage = Callable[[str, dict[str, Any]], None]
"""Called with topic and message after each is logged; it must not block."""


class _HasAddress(Protocol):
    @property
    def address(self) -> str: ...


View = TypeVar("View", bound=_HasAddress)


@contextmanager
def live_estimate(
    rig: Rig,
    open_view: Callable[[Array], AbstractContextManager[View]],
    show: Callable[[View, FixedLagSmoother], None],
) -> Iterator[tuple[str, OnMessage]]:
    """Estimate and display the robot's shape in another process while the context lasts.

    Args:
        rig: The rig whose messages the callback receives.
        open_view: Opens a view of the robot at arclengths (N,) m. Like `show`, it must be
            importable by name, because the other process imports it.
        show: Displays the newest state of a smoother in a view.

    Returns:
        The address of the view, and a callback that accepts the rig's messages.

    Raises:
        GlissandoError: The view cannot be opened, or the robot file states no noise of coils.
    """
    robot = load_robot(robot_file(rig.robot))
    if "coil" not in robot.sensor_std:
        raise GlissandoError(f"Robot {robot.name!r} states no noise of coils; add [sensors.coil].")
    context = multiprocessing.get_context("spawn")
    messages, address = context.Queue(), context.SimpleQueue()
    arguments = rig, open_view, show, messages, address
    process = context.Process(target=_estimate, args=arguments, daemon=True)
    with blocked_signals():
        process.start()
    try:
        while address.empty():
            if not process.is_alive():
                raise GlissandoError(
                    "The live view did not start; try pip install 'glissando[view]'."
                )
            time.sleep(0.05)
        yield str(address.get()), _forwarder(process, messages)
    finally:
        messages.put(None)
        process.join(_END)
        if process.is_alive():
            process.terminate()
        messages.cancel_join_thread()


def _forwarder(process: BaseProcess, messages: Any) -> OnMessage:
    """Callback that passes messages on, and prints one warning when the process has ended."""
    ended = threading.Event()

    def on_message(topic: str, message: dict[str, Any]) -> None:
        if process.is_alive():
            messages.put((topic, message))
        elif not ended.is_set():
            ended.set()
            warning = "glissando: the live view has ended; the recording goes on without it."
            print(warning, file=sys.stderr)

    return on_message


def _estimate(rig: Rig, open_view: Any, show: Any, messages: Any, address: Any) -> None:
    end_with_parent()
    robot = load_robot(robot_file(rig.robot))
    frames = CoilFrames(rig, robot)
    smoother = FixedLagSmoother(
        robot.prior, robot.arclength_nodes, sensor_parameters=robot.sensor_parameters
    )
    step, due = 1.0 / robot.time_rate, -np.inf
    with open_view(np.linspace(0.0, robot.length, _POINTS)) as view:
        address.put(view.address)
        while (item := messages.get()) is not None:
            for reading in frames.take(*item):
                smoother.add(reading)
                now = float(reading.time[0])
                if now >= due and messages.empty():  # else catch up first
                    with suppress(UnreachableError):  # the estimate is then at rest
                        smoother.advance(now)
                    due = now + step
                    show(view, smoother)
