"""Parsers of devices' and peers' messages, with damaged samples."""

import sys
from pathlib import Path

import numpy as np

from mutation_kinds import (
    mutated_bytes,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))


from glissando.errors import GlissandoError
from glissando.hardware.drivers import aurora_protocol, vicon
from glissando.hardware.drivers.slide import Slide
from glissando.hardware.drivers.stage import Stage
from glissando.hardware.openigtlink import decode, encode
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.message import HEADER, Framer
from glissando.hardware.simulated_devices import aurora_wire
from glissando.hardware.simulated_devices.aurora_wire import PortReport
from glissando.hardware.simulated_devices.dynamixel import crc16
from igtl_messages import random_messages
from mutation_samples import Parser
from servo_world import World, together


def line_parser(name, samples, read, resealed=None):
    """Parser of bytes of a connection; half of the damaged samples have a corrected checksum."""

    def mutate(rng, files):
        data = mutated_bytes(rng, files["line"])
        if resealed is not None and rng.random() < 0.5:
            data = resealed(data)
        return {"line": data}

    return Parser(name, [{"line": s} for s in samples], lambda f, *_: read(f["line"]), mutate)


def rigid(pose):
    """Raise unless a pose is finite and rigid: a parser must not accept other poses."""
    assert np.all(np.isfinite(pose)), "a pose is not finite"
    turn = pose[:3, :3]
    assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-2, "a pose is not a rigid motion"


def read_aurora(raw):
    reports = []
    for parse in (aurora_protocol.parse_tx, aurora_protocol.parse_bx):
        try:
            reports.append(parse(raw))
        except GlissandoError as problem:
            reason = problem
    try:
        aurora_protocol.parse_handles(aurora_protocol.parse_ascii(raw))
        return
    except GlissandoError:
        pass
    if not reports:
        raise reason
    for port in (port for report in reports for port in report.ports):
        if port.pose is not None:
            rigid(port.pose)


def aurora_parser():
    rng = np.random.default_rng(2)
    q = rng.normal(size=(3, 4))
    values = [np.r_[a / np.linalg.norm(a), rng.uniform(-500, 500, 3), 0.3] for a in q]
    reports = [PortReport(k + 10, 0x31, v, "") for k, v in enumerate(values)]
    reports.append(PortReport(20, 0, None, "DISABLED"))
    samples = [
        aurora_wire.tx_reply(reports, 7, 0, bare=True),
        aurora_wire.tx_reply(reports, 7, 0, bare=False),
        aurora_wire.bx_reply(reports, 7, 0),
        aurora_wire.text_reply("020A0010B001"),
    ]

    def resealed(data):
        if data[:2] == b"\xc4\xa5" and len(data) > 10:
            head = data[:2] + (len(data) - 8).to_bytes(2, "little")
            head += aurora_wire.crc(head).to_bytes(2, "little")
            return head + data[6:-2] + aurora_wire.crc(data[6:-2]).to_bytes(2, "little")
        return data[:-5] + b"%04X\r" % aurora_wire.crc(data[:-5])

    return line_parser("Aurora replies", samples, read_aurora, resealed)


def vicon_parser():
    def item(name, *values):
        return vicon._ITEM.pack(0, 72) + vicon._OBJECT.pack(name, *values)

    packet = vicon._FRAME.pack(7, 2)
    packet += item(b"tip", 1, 2, 3, 0.1, 0.2, 0.3) + item(b"mid", 4, 5, 6, 0.1, 0.2, 0.3)

    def read(raw):
        frame = vicon.parse_packet(raw, 0.0)
        for pose in frame.poses.values() if frame else ():
            rigid(pose)

    return line_parser("Vicon datagrams", [packet], read)


class SpoiltWorld(World):
    """A simulated servo with randomly damaged replies."""

    rng = None

    def writePort(self, packet):  # noqa: N802
        """Damage each reply with probability 0.3."""
        sent = super().writePort(packet)
        if self.rng is not None and self._due and self.rng.random() < 0.3:
            when, data = self._due.pop()
            data = mutated_bytes(self.rng, data)
            if self.rng.random() < 0.6 and len(data) > 4:
                data = data[:-2] + crc16(data[:-2]).to_bytes(2, "little")
            self._due.append((when, data))
        return sent


def read_servo(raw):
    """Make a short move with a servo whose replies are damaged; it must be at rest at the end."""
    world = SpoiltWorld()
    world.rng = np.random.default_rng(int.from_bytes(raw[:8].ljust(8, b"\0"), "little"))
    stage = Stage(lead=0.0254, stroke=(0.0, 0.06), home=-0.002)
    try:
        with together(world), Slide("world", stage) as slide:
            slide.home_here(world.screw.travel)
            slide.move(0.032)
    finally:
        world.passes(1.0)
        rest = world.travel[-1][1]
        world.passes(1.0)
        assert abs(world.travel[-1][1] - rest) < 1e-6, "the stage still moves"
        places = [travel for _, travel in world.travel]
        assert 0.028 < min(places) <= max(places) < 0.034, "the stage left its way"


def igtl_parser():
    rng = np.random.default_rng(3)
    samples = [encode(message) for message in random_messages(rng)]

    def read(raw):
        for message in Framer().feed(raw):
            decode(message)

    def resealed(data):
        if len(data) < HEADER:
            return data
        head, body = bytearray(data[:HEADER]), data[HEADER:]
        head[42:50] = len(body).to_bytes(8, "big")
        head[50:58] = crc64(body).to_bytes(8, "big")
        return bytes(head) + body

    return line_parser("OpenIGTLink", samples, read, resealed)
