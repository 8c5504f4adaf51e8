"""A simulated NDI Aurora in a separate process.

python -m glissando.hardware.simulated_devices.aurora --scene FILE --tcp 0
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from glissando.errors import SimulationError
from glissando.hardware.simulated_devices.aurora_device import Device, DeviceIdentity, Sensing
from glissando.hardware.simulated_devices.faults import AuroraFaults, FaultDraws, parse_faults
from glissando.hardware.simulated_devices.scene import Scene
from glissando.hardware.simulated_devices.serving import (
    Serving,
    device_parser,
    finite,
    port,
    positive,
    run_device,
)
from glissando.hardware.simulated_devices.travel import Travel

_HELP = """\
A simulated NDI Aurora that answers with the device's bytes, for any client of one. Prints its
address as one line when ready; ends when standard input closes or at SIGTERM.
"""


def _parser() -> argparse.ArgumentParser:
    parser = device_parser("aurora", _HELP, AuroraFaults)
    add = parser.add_argument
    add("--scene", type=Path, required=True, metavar="FILE", help="NPZ with robot and coils")
    add("--tcp", type=port, metavar="PORT", help="serve TCP on this port, 0 for any")
    add("--pty", type=Path, metavar="LINK", help="serve a pseudo-terminal that this leads to")
    add("--travel", type=port, metavar="PORT", help="UDP port the slide's travel comes to")
    add("--epoch", type=finite, metavar="S", help="time.monotonic() when the scene begins")
    add("--rate", type=positive, default=40.0, metavar="HZ", help="frames a second (default 40)")
    add("--wired", action="store_true", help="replies take the time of the baud rate")
    add("--firmware", default="AURORA Rev 013", metavar="TAG", help="008 ends the use of BX")
    return parser


def _serve(options: argparse.Namespace) -> None:
    if options.tcp is None and options.pty is None:
        raise SimulationError("Nobody could connect: give --tcp PORT or --pty LINK.")
    scene = Scene.load(options.scene)
    faults = parse_faults(AuroraFaults, options.faults)
    born = time.monotonic()
    epoch = born if options.epoch is None else options.epoch
    nature = DeviceIdentity(born, options.rate, options.firmware, options.wired)
    travel = None if options.travel is None else Travel(options.travel)
    sensing = Sensing(scene, travel, born, epoch, options.rate)
    if scene.coils:
        sensing.values(0)  # compiles kernels before a client waits for a frame
    device = Device(scene, sensing, FaultDraws(faults, scene.seed), nature)
    serving = Serving(device.receive, device.cut)
    addresses = []
    if options.tcp is not None:
        addresses.append(serving.listen(options.tcp))
    if options.pty is not None:
        addresses.append(serving.open_terminal(options.pty))
    serving.run(*addresses)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated tracker; returns the exit status."""
    return run_device(_parser(), _serve, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
