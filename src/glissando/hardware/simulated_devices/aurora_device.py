"""Simulated Aurora: replies to commands, with the states and faults of the device."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.simulated_devices.aurora_ports import CommandError, Port, Ports
from glissando.hardware.simulated_devices.aurora_wire import (
    PortReport,
    bx_reply,
    crc,
    text_reply,
    tx_reply,
)
from glissando.hardware.simulated_devices.faults import FaultDraws
from glissando.hardware.simulated_devices.scene import Scene
from glissando.hardware.simulated_devices.travel import Travel
from glissando.simulation.imperfections import SmoothField
from glissando.simulation.tracker import error_twists, rolled

_BAUD = {"0": 9600, "1": 14400, "2": 19200, "3": 38400, "4": 57600, "5": 115200, "6": 921600}
_BAUD |= {"7": 1228739, "A": 230400}
_VERSION = (
    "Aurora Control Firmware\nNDI S/N: D4-00000\nCharacterization Date: 2016-12-21\n"
    "Freeze Tag: {}\nFreeze Date: 2013-07-25\n(C) Northern Digital Inc.\n"
)
_OUT, _PARTLY, _BROKEN = 0x40, 0x80, 0x100
_PLUGGED, _UNPLUGGED = 0x0040, 0x0080  # numbered as in ndicapi; NDI's sample is one bit off
_OLD = ("Rev 007", "Rev 008")  # firmware without BX
_HEAD = 6  # bytes of a reply that a serial line delivers first
_WIDE = 0x0800  # option: report poses outside the volume too
_PORT_COMMANDS = {
    "PHF": "free",
    "PVWR": "write",
    "TTCFG": "configure",
    "PINIT": "initialise",
    "PENA": "enable",
}


@dataclass(frozen=True)
class DeviceIdentity:
    """Constants of a simulated device.

    Attributes:
        born: Time at which it was switched on, s of time.monotonic().
        rate: Frames a second.
        firmware: Firmware that it reports.
        wired: Whether replies take the time that a serial line needs at its baud rate.
    """

    born: float
    rate: float = 40.0
    firmware: str = "AURORA Rev 013"
    wired: bool = False


class Sensing:
    """The frames of a tracker: frame `index` is measured at `born` + index / `rate` s.

    Args:
        scene: The robot and its coils.
        travel: Source of the slide's travel; None for zero travel.
        born: Time at which the device was switched on, s of time.monotonic().
        epoch: Time at which the scene begins, by the same clock.
        rate: Frames a second.
    """

    def __init__(self, scene: Scene, travel: Travel | None, born: float, epoch: float, rate: float):
        self._scene, self._travel = scene, travel
        self._born, self._epoch, self._rate = born, epoch, rate
        rng = np.random.default_rng([scene.seed, 0])
        self._bias = SmoothField.draw(rng, 3, 5, scene.flaws.bias_length)
        self._roll = rng.bit_generator.seed_seq.spawn(1)[0]  # type: ignore[attr-defined]
        self.values = lru_cache(64)(self._values)

    def _values(self, index: int) -> Array:
        """Values (C, 8) of a frame: quaternion [w, x, y, z], position in mm, quality."""
        scene, moment = self._scene, self._born + index / self._rate
        travel = self._travel.at(moment) if self._travel else 0.0
        rng = np.random.default_rng([scene.seed, 1, index])
        pose = scene.T_wt @ scene.coil_poses(scene.time[0] + moment - self._epoch, travel)
        noise = rng.standard_normal((len(pose), 5))
        pose = pose @ se3.exp(error_twists(noise, self._bias, pose, scene.flaws))
        pose = se3.inverse(scene.T_wt) @ pose
        pose = rolled(pose, scene.flaws.roll, np.random.default_rng(self._roll))
        quality = rng.uniform(0.02, 0.2, (len(pose), 1))
        return np.hstack([se3.quaternion(pose[:, :3, :3]), 1e3 * pose[:, :3, 3], quality])


class Device:
    """State machine of the device. Times are of time.monotonic()."""

    def __init__(self, scene: Scene, sensing: Sensing, dice: FaultDraws, nature: DeviceIdentity):
        self._sensing, self._dice, self._nature = sensing, dice, nature
        faults = dice.faults
        without = {int(faults.srom), int(faults.bad_srom)}
        self._ports = Ports(scene.coils, without, int(faults.bad_srom))
        self._tracked: float | None = None  # time at which tracking first began
        self._zero = -int(faults.counter)  # the index of the frame with number 0
        self._replies, self._before = 0, b""
        self._plugs = [(faults.unplug, _UNPLUGGED), (faults.replug, _PLUGGED)]
        self._reset_due = True
        self._news = 0
        self._baud = 9600
        self._clear(initialised=False)

    def _clear(self, *, initialised: bool) -> None:
        self._initialised, self._tracking = initialised, False
        self._ports.clear()

    def receive(self, held: bytearray, now: float) -> list[tuple[float, bytes]]:
        """Execute and remove the complete commands in `held`; returns times (s) and replies."""
        answers = []
        while (end := held.find(b"\r")) >= 0:
            line, held[:] = bytes(held[:end]).strip(b"\n"), held[end + 1 :]
            if line:
                answers += self._answer(line, now)
        if len(held) > 4096:
            held.clear()
        return [answer for answer in answers if answer[1]]

    def cut(self, now: float) -> bool:
        """Whether the link is interrupted at present."""
        since = self._since(now)
        return self._dice.faults.cut <= since < self._dice.faults.mended

    def _since(self, now: float) -> float:
        return -math.inf if self._tracked is None else now - self._tracked

    def _answer(self, line: bytes, now: float) -> list[tuple[float, bytes]]:
        """Times and bytes of a reply; on a serial line its beginning arrives before its end."""
        byte = 10.0 / self._baud if self._nature.wired else 0.0  # s
        now += (len(line) + 1) * byte
        tracking, name = self._tracking, ""
        try:
            name, text = _command(line)
            reply = self._execute(name, text, now)
        except CommandError as refusal:
            reply = text_reply(f"ERROR{refusal.args[0]:02X}")
        now += self._dice.faults.slow_init if name == "INIT" else 0.0
        self._replies += 1
        reply = self._with_faults(reply, tracking)
        if not byte:
            return [(now, reply)]
        return [(now + _HEAD * byte, reply[:_HEAD]), (now + len(reply) * byte, reply[_HEAD:])]

    def _with_faults(self, reply: bytes, tracking: bool) -> bytes:
        dice, k = self._dice, self._replies
        if not tracking:
            return dice.flip(reply, "crc_setup", k)
        if dice("repeat", k) and self._before:
            reply = self._before
        self._before = reply
        reply = dice.flip(reply, "crc", k)
        reply = dice.cut(reply, "truncate", k)
        return b"" if dice("quiet", k) else reply

    def _execute(self, name: str, text: str, now: float) -> bytes:
        if name in ("TX", "BX"):
            self._require(tracking=True)
            return self._report(name, text, now)
        if name == "RESET":
            self._baud = 9600
            self._clear(initialised=False)
            return text_reply("RESET")
        if name == "INIT":  # while tracking too, which then ends [inferred]
            self._clear(initialised=True)
            return text_reply("OKAY")
        if name == "TSTOP":
            self._require(tracking=True)
            self._tracking = False
            return text_reply("OKAY")
        if name not in (*_PORT_COMMANDS, "COMM", "VER", "PHSR", "PHINF", "TSTART"):
            raise CommandError(0x01)
        if name != "COMM":
            self._require(tracking=False)
        return text_reply(self._set_up(name, text, now))

    def _require(self, *, tracking: bool) -> None:
        if not self._initialised:
            raise CommandError(0x10)
        if self._tracking != tracking:
            raise CommandError(0x0C)

    def _set_up(self, name: str, text: str, now: float) -> str:
        """Text of the reply to a command of the set-up mode."""
        if name == "VER":
            if text not in ("0", "4"):
                raise CommandError(0x23)
            return _VERSION.format(self._nature.firmware)
        if name == "PHSR":
            ports = self._ports.listed(_hexadecimal(text or "00"))
            return f"{len(ports):02X}" + "".join(f"{p.handle:02X}{p.status:03X}" for p in ports)
        if name == "PHINF":
            return self._ports.describe(text)
        if name == "COMM":
            if len(text) != 5 or text[0].upper() not in _BAUD or text[1:] != "0000":
                raise CommandError(0x06)
            self._baud = _BAUD[text[0].upper()]
        elif name == "TSTART":
            self._start(text, now)
        elif name in _PORT_COMMANDS:
            getattr(self._ports, _PORT_COMMANDS[name])(text)
            if name == "PINIT" and self._dice.faults.warning:
                return "WARNING01"
        return "OKAY"

    def _start(self, text: str, now: float) -> None:
        if text not in ("", "40"):
            raise CommandError(0x23)
        self._tracking = True
        if self._tracked is None:
            self._tracked = now

    def _index(self, now: float) -> int:
        """Index of the newest frame that is not dropped."""
        nature = self._nature
        index = math.floor((now - nature.born) * nature.rate)
        while self._dice("drop", index):
            index -= 1
        return index

    def _report(self, name: str, text: str, now: float) -> bytes:
        if name == "BX" and any(old in self._nature.firmware for old in _OLD):
            raise CommandError(0x01)
        options = _hexadecimal(text or "0001")
        if options & ~(0x0001 | _WIDE):
            raise CommandError(0x23)
        self._apply_due_faults(now)
        index = self._index(now)
        reports = [self._port_report(p, index, options) for p in self._ports.all if p.enabled]
        frame, status, self._news = (index - self._zero) % 2**32, self._news, 0
        if name == "BX":
            return bx_reply(reports, frame, status)
        return tx_reply(reports, frame, status, bool(self._dice.faults.bare))

    def _apply_due_faults(self, now: float) -> None:
        """Apply faults that are due: a coil unplugged or plugged in, a reset of the counter."""
        since = self._since(now)
        while self._plugs and since >= self._plugs[0][0]:
            _, event = self._plugs.pop(0)
            (self._ports.unplug if event == _UNPLUGGED else self._ports.plug)(0)
            self._news |= event
        if self._reset_due and since >= self._dice.faults.reset:
            self._zero, self._reset_due = self._index(now), False

    def _port_report(self, port: Port, index: int, options: int) -> PortReport:
        coil, dice = port.coil, self._dice
        if not port.occupied:
            return PortReport(port.handle, port.status, None, "UNOCCUPIED")
        out, broken = dice("out", index, coil), coil == int(dice.faults.broken)
        status = port.status | out * _OUT | dice("partly", index, coil) * _PARTLY | broken * _BROKEN
        unseen = dice.missing(index, coil) or broken or (out and not options & _WIDE)
        values = None if unseen else self._sensing.values(index)[coil]
        return PortReport(port.handle, status, values)


def _command(line: bytes) -> tuple[str, str]:
    """Split 'NAME:arguments' with a CRC, or 'NAME arguments' without, into name and arguments."""
    if not line.isascii():
        raise CommandError(0x04 if b":" in line else 0x01)
    text = line.decode("ascii")
    name, colon, rest = text.partition(":")
    if colon and " " not in name:
        if len(rest) < 4 or f"{crc(line[:-4]):04X}" != rest[-4:].upper():
            raise CommandError(0x04)
        return name.upper(), rest[:-4]
    name, _, rest = text.partition(" ")
    return name.upper(), rest.strip()


def _hexadecimal(digits: str) -> int:
    try:
        return int(digits, 16)
    except ValueError:
        raise CommandError(0x07) from None
