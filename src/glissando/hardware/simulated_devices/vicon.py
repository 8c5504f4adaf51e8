"""A simulated Vicon Tracker, which sends the bodies of a scene as a UDP object stream.

    python -m glissando.hardware.simulated_devices.vicon --scene FILE --to HOST:PORT \
        --bodies tip=0.7,mid=0.35

Prints one line that begins with 'ready', then sends a frame at each multiple of 1/rate after the
epoch, until SIGTERM or the end of its standard input; the scene is at rest after its end.
"""

from __future__ import annotations

import argparse
import socket
import struct
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import SimulationError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.simulated_devices.faults import FaultDraws, parse_faults
from glissando.hardware.simulated_devices.scene import Scene
from glissando.hardware.simulated_devices.serving import (
    Serving,
    address,
    device_parser,
    finite,
    port,
    positive,
    run_device,
    seed,
)
from glissando.hardware.simulated_devices.travel import Travel

NOISE_MM, NOISE_RAD = 0.15, 1.5e-3  # RMS over all directions


@dataclass(frozen=True)
class MocapFaults:
    """Probabilities of faults by name; all zero by default.

    For a frame: `lost`, `late` (sent after the next one), `repeated`, `truncated`; for each of its
    bodies: `occluded`.
    """

    lost: float = 0.0
    late: float = 0.0
    repeated: float = 0.0
    truncated: float = 0.0
    occluded: float = 0.0


def parse_bodies(text: str) -> dict[str, float]:
    """Arclengths (m) of bodies by name, from `NAME=S,…`. Raises SimulationError."""
    pairs = [part.partition("=")[::2] for part in text.split(",")]
    try:
        bodies = {name.strip(): float(place) for name, place in pairs}
    except ValueError:
        raise SimulationError(f"Bodies {text!r}: give NAME=ARCLENGTH,… in metres.") from None
    if any(not 0 < len(name.encode()) <= 24 for name in bodies):
        raise SimulationError(f"Bodies {text!r}: give each a name of 1 to 24 bytes.")
    return bodies


class Sender:
    """Datagrams of the bodies of a scene in Tracker's format, with faults.

    Args:
        scene: The robot in motion.
        bodies: Arclengths of the bodies by name, m.
        faults: Faults of the stream; none if None.
        seed: Seed of noise and faults.
        tube: Name of the body on the sliding tube, and its distance behind the robot's base when
            the travel is zero, m; None for none.
        travel: Travel of the slide, m, as a function of seconds after the scene's start.
    """

    def __init__(
        self, scene: Scene, bodies: dict[str, float], faults: MocapFaults | None = None,
        seed: int = 0, *, tube: tuple[str, float] | None = None,
        travel: Callable[[float], float] = lambda at: 0.0,
    ) -> None:  # fmt: skip
        self.scene, self._bodies, self._tube, self._travel = scene, bodies, tube, travel
        low, high = scene.arclength[[0, -1]]
        for arclength in bodies.values():
            if not low <= arclength <= high:
                raise SimulationError(
                    f"{arclength:g} lies outside the scene, {low:g} to {high:g}; give an arclength "
                    f"inside."
                )
        self._dice = FaultDraws(MocapFaults() if faults is None else faults, seed)
        self._rng = np.random.default_rng(seed)
        self._late: list[bytes] = []

    def datagrams(self, number: int, at: float) -> list[bytes]:
        """Datagrams, if any, sent for frame `number` at `at` s after the scene's start."""
        dice = self._dice
        poses, names = self._poses(at), [*self._bodies, *(self._tube or ())[:1]]
        noise = np.repeat([1e-3 * NOISE_MM, NOISE_RAD], 3) / np.sqrt(3.0)
        poses = poses @ se3.exp(noise * self._rng.standard_normal((len(poses), 6)))
        data = struct.pack("<IB", number % (1 << 32), len(names))
        for k, (name, pose) in enumerate(zip(names, poses, strict=True)):
            values = [0.0] * 6 if dice("occluded", number, k) else _values(pose)
            data += struct.pack("<BH24s6d", 0, 72, name.encode(), *values)
        data = dice.cut(data, "truncated", number)
        before, self._late = self._late, []
        if dice("lost", number):
            return before
        if dice("late", number):
            self._late = [data]
            return before
        return [data, *before] + [data] * dice("repeated", number)

    def _poses(self, at: float) -> Array:
        """Poses (B, 4, 4) of all bodies `at` s after the scene's start."""
        poses = self.scene.pose(list(self._bodies.values()), self.scene.time[0] + at)
        if self._tube is None:
            return poses
        behind = self.scene.pose([self.scene.arclength[0]], self.scene.time[0] + at)
        behind[0, :3, 3] -= (self._tube[1] + self._travel(at)) * behind[0, :3, 2]
        return np.concatenate([poses, behind])


def _values(pose: Array) -> list[float]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # any angles are valid at gimbal lock
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("XYZ")
    return [*(1e3 * pose[:3, 3]), *angles]


def _parser() -> argparse.ArgumentParser:
    parser = device_parser("vicon", __doc__, MocapFaults)
    add = parser.add_argument
    add("--scene", type=Path, required=True, metavar="FILE", help="NPZ file of the robot's motion")
    add("--to", type=address, required=True, metavar="HOST:PORT", help="where the datagrams go")
    add("--bodies", required=True, metavar="NAME=S,…", help="arclengths of the bodies, m")
    add("--rate", type=positive, default=100.0, metavar="HZ", help="frames a second (default 100)")
    add("--epoch", type=finite, metavar="T", help="monotonic time of the scene's start (now)")
    add("--seed", type=seed, default=0, metavar="N", help="of noise and faults (default 0)")
    tube = "a body on the sliding tube, so far behind the robot's base at travel zero"
    add("--tube", metavar="NAME=M", help=tube)
    add("--travel", type=port, metavar="PORT", help="UDP port the slide's travel comes to")
    return parser


def _serve(options: argparse.Namespace) -> None:
    faults, bodies = parse_faults(MocapFaults, options.faults), parse_bodies(options.bodies)
    scene = Scene.load(options.scene)
    Sender(scene, bodies).datagrams(0, 0.0)  # compiles kernels before the first frame is due
    epoch = time.monotonic() if options.epoch is None else options.epoch
    tube = next(iter(parse_bodies(options.tube).items())) if options.tube else None
    come = Travel(options.travel) if options.travel is not None else None
    sender = Sender(
        scene, bodies, faults, options.seed, tube=tube,
        travel=(lambda at: come.at(epoch + at)) if come else (lambda at: 0.0),
    )  # fmt: skip
    number = max(0, int(np.ceil((time.monotonic() - epoch) * options.rate)))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def beat(now: float) -> float:
            nonlocal number
            while epoch + number / options.rate <= now:
                for data in sender.datagrams(number + 1, number / options.rate):
                    out.sendto(data, options.to)
                number += 1
            return epoch + number / options.rate

        Serving(beat=beat).run("ready {}:{} {:g} Hz".format(*options.to, options.rate))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sender; returns the exit status."""
    return run_device(_parser(), _serve, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
