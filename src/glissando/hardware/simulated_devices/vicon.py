"""A Vicon Tracker that is not there: a scene's bodies as a UDP object stream.

    python -m glissando.hardware.simulated_devices.vicon --scene FILE --to HOST:PORT \
        --bodies tip=0.7,mid=0.35

Prints one line that begins with 'ready', sends a frame at each multiple of 1/rate after the epoch
until the scene ends, and exits with 0. A scene is an NPZ file: time (K,) s, arclength (M,) m,
T_wb (K, M, 4, 4).
"""

from __future__ import annotations

import argparse
import os
import socket
import struct
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import GlissandoError, SimulationError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.io.toml_table import read_toml

NOISE_MM, NOISE_RAD = 0.15, 1.5e-3  # RMS over all directions
FAULTS = ("lost", "late", "repeated", "occluded", "absent", "truncated", "garbage", "padded")
"""Chances, of a frame or (occluded, absent) of each of its bodies."""


@dataclass(frozen=True)
class Body:
    """Markers fixed to the robot at an arclength (m): their frame in the cross-section's."""

    name: str
    arclength: float
    T_body_marker: Array = field(default_factory=lambda: np.eye(4))


def read_bodies(text: str) -> list[Body]:
    """Bodies from `NAME=S,…`, or from a TOML file's [[bodies]] with name, arclength and mount."""
    if "=" not in text:
        table = read_toml(Path(text), SimulationError)
        bodies = []
        for entry in table.tables("bodies"):
            place = entry.number("arclength", positive=False)
            bodies.append(Body(entry.text("name"), place, entry.pose()))
            entry.close()
        table.close()
    else:
        pairs = [part.partition("=")[::2] for part in text.split(",")]
        try:
            bodies = [Body(name.strip(), float(place)) for name, place in pairs]
        except ValueError:
            raise SimulationError(f"Bodies {text!r}: give NAME=ARCLENGTH,… in metres.") from None
    if not bodies or any(not 0 < len(b.name.encode()) <= 24 for b in bodies):
        raise SimulationError("Give one body or more, with names of 1 to 24 bytes.")
    return bodies


def read_scene(path: Path) -> tuple[Array, Array, Array]:
    """Times (K,), arclengths (M,) and poses T_wb (K, M, 4, 4) of a scene file."""
    try:
        with np.load(path) as file:
            return file["time"], file["arclength"], file["T_wb"]
    except (OSError, ValueError, KeyError) as problem:
        raise SimulationError(
            f"Scene {path} cannot be read ({problem}); give an NPZ file with time, arclength, T_wb."
        ) from None


def between(nodes: Array, poses: Array, at: float) -> Array:
    """Pose at one place between nodes (K,) of poses (K, …, 4, 4), constant twist between two."""
    if not nodes[0] <= at <= nodes[-1]:
        raise SimulationError(f"{at:g} lies outside the scene, {nodes[0]:g} to {nodes[-1]:g}.")
    if nodes.size == 1:
        return poses[0]
    low = int(np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2))
    share = (at - nodes[low]) / (nodes[low + 1] - nodes[low])
    return poses[low] @ se3.exp(share * se3.log(se3.inverse(poses[low]) @ poses[low + 1]))


class Sender:
    """Datagrams of the bodies of a scene, as Tracker would send them, faults included."""

    def __init__(
        self,
        scene: tuple[Array, Array, Array],
        bodies: Sequence[Body],
        faults: dict[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        self.time, arclength, T_wb = scene
        along = np.swapaxes(T_wb, 0, 1)
        self.bodies = bodies
        self.tracks = [between(arclength, along, b.arclength) @ b.T_body_marker for b in bodies]
        self.faults = faults or {}
        self.rng = np.random.default_rng(seed)
        self._late: list[bytes] = []

    def datagrams(self, number: int, at: float) -> list[bytes]:
        """What is sent for frame `number` at scene time `at`: none, one or more datagrams."""
        data = b"".join(self._item(b, t, at) for b, t in zip(self.bodies, self.tracks, strict=True))
        data = struct.pack("<IB", number % (1 << 32), len(data) // 75) + data
        if self._strikes("padded"):
            data += bytes(-len(data) % 256)
        if self._strikes("truncated"):
            data = data[: self.rng.integers(len(data))]
        if self._strikes("garbage"):
            data = self.rng.bytes(int(self.rng.integers(1, 300)))
        before, self._late = self._late, []
        if self._strikes("lost"):
            return before
        if self._strikes("late"):
            self._late = [data]
            return before
        return [data, *before] + [data] * self._strikes("repeated")

    def _item(self, body: Body, track: Array, at: float) -> bytes:
        if self._strikes("absent"):
            return b""
        noise = np.repeat([1e-3 * NOISE_MM, NOISE_RAD], 3) / np.sqrt(3.0)
        pose = between(self.time, track, at) @ se3.exp(noise * self.rng.standard_normal(6))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # at gimbal lock any split will do
            angles = Rotation.from_matrix(pose[:3, :3]).as_euler("XYZ")
        values = [*(1e3 * pose[:3, 3]), *angles]
        if self._strikes("occluded"):
            values = [0.0] * 6
        return struct.pack("<BH24s6d", 0, 72, body.name.encode(), *values)

    def _strikes(self, fault: str) -> bool:
        return bool(self.rng.uniform() < self.faults.get(fault, 0.0))


def read_faults(text: str) -> dict[str, float]:
    """Chances from `NAME=CHANCE,…`. Raises SimulationError for an unknown name or chance."""
    faults = {}
    for part in filter(None, text.split(",")):
        name, _, chance = part.partition("=")
        try:
            faults[name] = float(chance)
        except ValueError:
            faults[name] = -1.0
        if name not in FAULTS or not 0.0 <= faults[name] <= 1.0:
            raise SimulationError(
                f"Fault {part!r} cannot be; give NAME=CHANCE with a chance from 0 to 1 and one of "
                f"{', '.join(FAULTS)}."
            )
    return faults


def send(
    sender: Sender, to: tuple[str, int], rate: float, epoch: float, *, hold: bool = False
) -> None:
    """Send the scene's frames when they are due: frame k at `epoch` + k/rate, monotonic seconds.

    If asked to `hold`, the scene stands still at its end, and this never does.
    """
    first = max(0, int(np.ceil((time.monotonic() - epoch) * rate)))
    start, end = float(sender.time[0]), float(sender.time[-1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        last = int(np.floor((end - start) * rate + 1e-9))
        for number in count(first) if hold else range(first, last + 1):
            time.sleep(max(0.0, epoch + number / rate - time.monotonic()))
            for data in sender.datagrams(number + 1, min(start + number / rate, end)):
                out.sendto(data, to)


def _end_with_input() -> None:
    sys.stdin.read()
    os._exit(0)  # the sender may be asleep


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sender; returns its exit status."""
    parser = argparse.ArgumentParser(prog="vicon", description=__doc__)
    add = parser.add_argument
    add("--scene", type=Path, required=True, metavar="FILE", help="NPZ file of the robot's motion")
    add("--to", required=True, metavar="HOST:PORT", help="where the datagrams go")
    add("--bodies", required=True, metavar="NAME=S,…|FILE", help="bodies, or a TOML file of them")
    add("--rate", type=float, default=100.0, metavar="HZ", help="frames a second (default 100)")
    add("--epoch", type=float, metavar="T", help="monotonic time of the scene's start (now)")
    add("--faults", default="", metavar="NAME=CHANCE,…", help=f"of {', '.join(FAULTS)}")
    add("--seed", type=int, default=0, metavar="N", help="of noise and faults (default 0)")
    holds = "stand still at the scene's end, until standard input closes"
    add("--hold", action="store_true", help=holds)
    options = parser.parse_args(arguments)
    try:
        host, _, port = options.to.rpartition(":")
        if not host or not port.isdigit() or not options.rate > 0.0:
            raise SimulationError("Give --to HOST:PORT and a --rate above zero.")
        faults, bodies = read_faults(options.faults), read_bodies(options.bodies)
        sender = Sender(read_scene(options.scene), bodies, faults, options.seed)
        epoch = time.monotonic() if options.epoch is None else options.epoch
        print(f"ready {options.to} {options.rate:g} Hz", flush=True)
        if options.hold:
            threading.Thread(target=_end_with_input, daemon=True).start()
        send(sender, (host, int(port)), options.rate, epoch, hold=options.hold)
    except (GlissandoError, OSError) as problem:
        print(f"vicon: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
