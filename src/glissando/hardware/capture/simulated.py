"""A simulated rig: each device is a process, and all share one robot and one slide."""

from __future__ import annotations

import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
from pathlib import Path

import numpy as np

from glissando.errors import SimulationError
from glissando.hardware.capture.setup import Body, Coil, Rig
from glissando.hardware.drivers import Stage
from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.scene import Scene, SceneCoil
from glissando.io.shipped_robots import robot_file
from glissando.model.tendons.channel import Channel
from glissando.simulation import Tendon, load_bench
from glissando.simulation.channel import straight_length

_LEAD = 0.0254  # m per revolution
_TRIES = 5  # attempts to start a device on a free port
_BEYOND = 2e-3  # m from the ends of the stroke to the hard stops
_BEHIND = 0.1  # m from the base back to the body on the sliding tube
_SCENE_RATE = 20.0  # Hz at which the shapes of a moving robot are sampled for the devices


@contextmanager
def simulated_rig(
    robot: str = "sliding700",
    shape: str = "S",
    seed: int = 0,
    faults: str = "",
    channel: Channel | None = None,
) -> Iterator[Rig]:
    """A rig of simulated devices that run while the context lasts.

    Args:
        robot: Shipped robot or robot file; its [physics] defines the physics, tracker and stage.
        shape: Name or file of the robot's shape, which may be a motion.
        seed: Seed of the noise.
        faults: Faults of the tracker, 'name=number,…', as its --help lists them.
        channel: Channel beside the backbone in which the coil slides; None for the backbone itself.

    Raises:
        SimulationError: The robot, the shape or a fault does not exist.
    """
    bench = load_bench(robot_file(robot))
    motion = bench.move(bench.shape(shape), bench.flaws, seed)
    span = float(motion.time[-1] - motion.time[0])
    times = motion.time[0] + np.linspace(0.0, span, max(1, round(span * _SCENE_RATE) + 1))
    length, way = bench.rod.length, None
    if channel is not None:
        length, way = (
            straight_length(Tendon.in_channel(channel, length), length),
            channel.to_table(),
        )
    tip = length + bench.coil_offset
    coil = SceneCoil(tip, -1.0, np.eye(4), port=0, way=way)
    scene = Scene.of(motion, times, [coil], T_wt=bench.tracker, flaws=bench.flaws, seed=seed)
    limits = bench.slide
    stage = Stage(
        lead=_LEAD, stroke=(0.0, limits.stroke), speed=limits.speed,
        acceleration=limits.acceleration, watchdog=2.0, lag=0.02,
    )  # fmt: skip
    bodies = tuple(Body(f"mocap_{1e3 * s:g}", float(s), np.eye(4)) for s in bench.truth)
    mocap = _free_port()
    markers = ",".join(f"{body.name}={body.arclength!r}" for body in bodies)
    tube = Body("tube", np.nan, np.eye(4), slides=True)
    with ExitStack() as stack:
        file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "scene.npz"
        scene.save(file)
        begin = ("--epoch", repr(time.monotonic()), "--scene", str(file))
        served = "--tcp", "0", "--faults", faults
        tracker, travel = _start_with_travel(stack, "aurora", *begin, *served)
        options = ("--to", f"127.0.0.1:{mocap}", "--bodies", markers, "--seed", str(seed))
        behind = ("--tube", f"{tube.name}={_BEHIND}")
        _, tube_travel = _start_with_travel(stack, "vicon", *begin, *options, *behind)
        to = (("--travel", f"127.0.0.1:{port}") for port in (travel, tube_travel))
        stops = "--ends", repr(-_BEYOND), repr(limits.stroke + _BEYOND), "--lead", repr(_LEAD)
        servo = stack.enter_context(started("servo", *stops, *chain(*to)))
        coils = (Coil("coil", tip, channel=channel),)
        yield Rig(
            "simulated", robot, tracker, coils, servo, stage, 0.0, mocap,
            (*bodies, tube), frame=bench.tracker,
        )  # fmt: skip


def _start_with_travel(stack: ExitStack, name: str, *options: str) -> tuple[str, int]:
    """Start a device that receives the slide's travel; returns its address, and that UDP port.

    Another program may take the port before the device opens it; then another port is tried.
    """
    for attempts_left in reversed(range(_TRIES)):
        port = _free_port()
        try:
            return stack.enter_context(started(name, *options, "--travel", str(port))), port
        except SimulationError as problem:
            if not attempts_left or "listened on" not in str(problem):
                raise
    raise AssertionError("unreachable")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
