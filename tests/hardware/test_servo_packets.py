"""The simulated servo's packets: found in any bytes, obeyed only with a good checksum."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import law
from glissando.hardware.simulated_devices.dynamixel import BROADCAST, Bus, Do, Fault, crc16, packed
from glissando.hardware.simulated_devices.xl430 import Xl430
from servo_host import Host, words

VECTORS = {  # from the e-Manual
    "ping": ("ff ff fd 00 01 03 00 01 19 4e", 1, Do.PING, ""),
    "ping status": ("ff ff fd 00 01 07 00 55 00 06 04 26 65 5d", 1, Do.STATUS, "00 06 04 26"),
    "read": ("ff ff fd 00 01 07 00 02 84 00 04 00 1d 15", 1, Do.READ, "84 00 04 00"),
    "sync read": (
        "ff ff fd 00 fe 09 00 82 84 00 04 00 01 02 ce fa",
        BROADCAST,
        Do.SYNC_READ,
        "84 00 04 00 01 02",
    ),
    "stuffed write": (
        "ff ff fd 00 01 0a 00 03 68 00 ff ff fd fd 00 e2 7a",
        1,
        Do.WRITE,
        "68 00 ff ff fd 00",
    ),
}


def slow_crc(data):
    """Long division by x¹⁶ + x¹⁵ + x² + 1, bit by bit."""
    value = int.from_bytes(data, "big") << 16
    for bit in range(value.bit_length() - 1, 15, -1):
        if value >> bit & 1:
            value ^= 0x18005 << (bit - 16)
    return value


@law
@given(st.binary(max_size=40))
def test_the_checksum_is_the_remainder_of_a_division(data):
    assert crc16(data) == slow_crc(data)


@pytest.mark.parametrize("name", VECTORS)
def test_packets_are_those_of_the_manual(name):
    wire, identity, instruction, parameters = VECTORS[name]
    assert packed(identity, instruction, bytes.fromhex(parameters)) == bytes.fromhex(wire)


class Ear:
    """A servo that only remembers what it was told."""

    def __init__(self, identity=1):
        self.id, self.heard = identity, []

    def execute(self, instruction, parameters, now):
        self.heard.append((instruction, parameters))
        return 0, b""


ugly = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00, 0x55]), max_size=30).map(bytes)


@law
@given(st.lists(ugly, min_size=1, max_size=5), st.lists(st.integers(1, 20), max_size=30))
def test_any_parameters_arrive_as_they_were_sent_however_the_bytes_are_split(bodies, cuts):
    ear = Ear()
    bus = Bus([ear])
    wire = b"".join(packed(1, Do.WRITE, body) for body in bodies)
    for cut in cuts:
        bus.receive(wire[:cut], 1.0)
        wire = wire[cut:]
    bus.receive(wire, 1.0)
    assert ear.heard == [(Do.WRITE, body) for body in bodies]


@law
@given(ugly, ugly)
def test_a_packet_is_found_behind_noise_after_a_pause(noise, body):
    ear = Ear()
    bus = Bus([ear])
    bus.receive(noise, 1.0)
    bus.receive(packed(1, Do.WRITE, body), 2.0)
    assert ear.heard[-1] == (Do.WRITE, body)


def test_a_wrong_checksum_is_answered_and_does_nothing():
    host = Host().extended()
    before = bytes(host.servos[0].table._bytes)
    wire = bytearray(packed(1, Do.WRITE, words((116, 2), (3000, 4))))
    wire[-1] ^= 1
    (status,) = host.says(bytes(wire))
    assert status[8] == Fault.CRC
    assert bytes(host.servos[0].table._bytes) == before


any_instruction = st.one_of(st.sampled_from(list(Do)), st.integers(0, 255))
any_packet = st.builds(
    packed,
    st.sampled_from([1, 1, 1, 2, BROADCAST, 77]),
    any_instruction,
    st.one_of(
        st.binary(max_size=24),
        st.builds(
            lambda address, data: words((address, 2)) + data,
            st.integers(0, 700),
            st.binary(max_size=16),
        ),
    ),
)


@st.composite
def mutated(draw):
    """A packet with bytes changed, lost or added."""
    wire = bytearray(draw(any_packet))
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(wire) - 1))
        kind = draw(st.sampled_from(["change", "lose", "add"]))
        if kind == "change":
            wire[place] ^= draw(st.integers(1, 255))
        elif kind == "lose" and len(wire) > 1:
            del wire[place]
        else:
            wire.insert(place, draw(st.integers(0, 255)))
    return bytes(wire)


@pytest.mark.slow
@settings(max_examples=600, deadline=None, derandomize=True)
@given(st.lists(st.one_of(any_packet, mutated(), st.binary(max_size=40)), min_size=16, max_size=20))
def test_no_bytes_crash_the_servo_and_it_answers_a_ping_afterwards(stream):
    """10,000 packets and more: random ones, mutated ones and noise."""
    host = Host(Xl430(identity=1), Xl430(identity=2))
    for data in stream:
        for status in host.says(data):
            assert crc16(status[:-2]) == int.from_bytes(status[-2:], "little")
        host.now += 0.003
    host.now += 1.0
    for servo in host.servos:  # whatever it is called by now, and however it may answer
        servo.table["status_return"] = 2
    called = {servo.id for servo in host.servos}
    pings = host.says(packed(BROADCAST, Do.PING))
    assert {status[4] for status in pings} == called


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.lists(st.one_of(mutated(), st.binary(max_size=40)), min_size=1, max_size=5))
def test_nothing_is_done_that_was_not_said_with_a_good_checksum(stream):
    ear = Ear()
    bus = Bus([ear])
    bus.receive(b"".join(stream), 1.0)
    for instruction, parameters in ear.heard:  # mutations of FF FF FD FD may leave it sound
        if instruction not in (Do.READ, Do.WRITE):  # which stand for parts of sync and bulk ones
            said = [packed(k, instruction, parameters) for k in (1, BROADCAST)]
            assert any(wire in b"".join(stream) for wire in said)


@law
@given(any_packet, st.data())
def test_a_packet_with_one_byte_changed_is_never_obeyed(wire, data):
    ear = Ear()
    place = data.draw(st.integers(0, len(wire) - 1))
    changed = bytearray(wire)
    changed[place] ^= data.draw(st.integers(1, 255))
    Bus([ear]).receive(bytes(changed), 1.0)
    assert ear.heard == []
