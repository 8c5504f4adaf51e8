"""The simulated servo's packets and registers, and the faults of its line."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import law
from glissando.errors import SimulationError
from glissando.hardware.simulated_devices.dynamixel import Do, Fault, Parser, crc16, packed
from glissando.hardware.simulated_devices.faults import parse_faults
from glissando.hardware.simulated_devices.servo import Line, ServoFaults
from glissando.hardware.simulated_devices.xl430 import Xl430
from servo_host import Host, words

VECTORS = {  # from the e-Manual
    "ping": ("ff ff fd 00 01 03 00 01 19 4e", Do.PING, ""),
    "ping status": ("ff ff fd 00 01 07 00 55 00 06 04 26 65 5d", Do.STATUS, "00 06 04 26"),
    "read": ("ff ff fd 00 01 07 00 02 84 00 04 00 1d 15", Do.READ, "84 00 04 00"),
    "stuffed write": (
        "ff ff fd 00 01 0a 00 03 68 00 ff ff fd fd 00 e2 7a", Do.WRITE, "68 00 ff ff fd 00",
    ),
}  # fmt: skip


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
    wire, instruction, parameters = VECTORS[name]
    assert packed(1, instruction, bytes.fromhex(parameters)) == bytes.fromhex(wire)


def sound(parser, data, now=1.0):
    """Instruction and parameters of the sound packets that these bytes complete."""
    return [(p.instruction, p.parameters) for p in parser.feed(data, now) if p.sound]


ugly = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00, 0x55]), max_size=30).map(bytes)


@law
@given(st.lists(ugly, min_size=1, max_size=5), st.lists(st.integers(1, 20), max_size=30))
def test_any_parameters_arrive_as_they_were_sent_however_the_bytes_are_split(bodies, cuts):
    parser, packets = Parser(), []
    wire = b"".join(packed(1, Do.WRITE, body) for body in bodies)
    for cut in cuts:
        packets += sound(parser, wire[:cut])
        wire = wire[cut:]
    packets += sound(parser, wire)
    assert packets == [(Do.WRITE, body) for body in bodies]


@law
@given(ugly, ugly)
def test_a_packet_is_found_behind_noise_after_a_pause(noise, body):
    parser = Parser()
    sound(parser, noise, 1.0)
    assert sound(parser, packed(1, Do.WRITE, body), 2.0)[-1] == (Do.WRITE, body)


def test_a_wrong_checksum_is_answered_and_does_nothing():
    host = Host().extended()
    before = bytes(host.servo.table._bytes)
    wire = bytearray(packed(1, Do.WRITE, words((116, 2), (3000, 4))))
    wire[-1] ^= 1
    (status,) = host.send(bytes(wire))
    assert status[8] == Fault.CRC
    assert bytes(host.servo.table._bytes) == before


any_parameters = st.one_of(
    st.binary(max_size=24),
    st.builds(
        lambda address, data: words((address, 2)) + data,
        st.integers(0, 700),
        st.binary(max_size=16),
    ),
)
any_instruction = st.one_of(st.sampled_from(list(Do)), st.integers(0, 255))
any_packet = st.builds(packed, st.sampled_from([1, 1, 1, 2, 254]), any_instruction, any_parameters)


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
    host = Host()
    for data in stream:
        for status in host.send(data):
            assert crc16(status[:-2]) == int.from_bytes(status[-2:], "little")
        host.now += 0.003
    host.now += 1.0
    identity = host.servo.table["id"]  # whatever it is by now
    assert host.ask(Do.PING, identity=identity)[1] == words((1060, 2), (45, 1))


@pytest.mark.slow
@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.lists(st.one_of(mutated(), st.binary(max_size=40)), min_size=1, max_size=5))
def test_nothing_is_obeyed_that_was_not_sent_with_a_good_checksum(stream):
    for packet in Parser().feed(b"".join(stream), 1.0):
        if packet.sound:
            wire = packed(packet.id, packet.instruction, packet.parameters)
            assert wire in b"".join(stream)


@law
@given(any_packet, st.data())
def test_a_packet_with_one_byte_changed_is_never_obeyed(wire, data):
    place = data.draw(st.integers(0, len(wire) - 1))
    changed = bytearray(wire)
    changed[place] ^= data.draw(st.integers(1, 255))
    assert sound(Parser(), bytes(changed)) == []


# Registers.


def test_a_new_servo_is_an_xl430_in_position_mode_without_torque():
    host = Host()
    assert host.ask(Do.PING) == (0, words((1060, 2), (45, 1)))
    assert [host.read(*register) for register in ((11, 1), (64, 1), (44, 4))] == [3, 0, 265]
    assert host.send(packed(2, Do.PING)) == []  # somebody else


@pytest.mark.parametrize(
    ("address", "value", "size", "fault"),
    [
        (0, 1, 2, Fault.ACCESS),  # read only
        (132, 1, 4, Fault.ACCESS),
        (14, 1, 1, Fault.ACCESS),  # nothing there
        (116, 1, 2, Fault.LENGTH),  # half a register
        (117, 1, 1, Fault.ACCESS),
        (11, 2, 1, Fault.RANGE),
        (112, 266, 4, Fault.LIMIT),  # beyond the velocity limit
        (116, 4096, 4, Fault.LIMIT),  # beyond one turn in position mode
        (100, 886, 2, Fault.RANGE),
    ],
)
def test_what_must_not_be_written_is_refused_and_nothing_changes(address, value, size, fault):
    host = Host()
    before = bytes(host.servo.table._bytes)
    assert host.write(address, value, size) == fault
    assert bytes(host.servo.table._bytes) == before


def test_a_write_over_several_registers_is_all_or_nothing():
    host = Host()
    good = words((108, 2), (5, 4), (100, 4), (2000, 4))
    assert host.ask(Do.WRITE, good)[0] == 0
    assert host.ask(Do.WRITE, words((108, 2), (6, 4), (999, 4), (2001, 4)))[0] == Fault.LIMIT
    assert [host.read(at, 4) for at in (108, 112, 116)] == [5, 100, 2000]


def test_the_eeprom_is_locked_while_torque_is_on():
    host = Host().extended()
    assert [host.write(20, 100, 4), host.write(64, 0, 1), host.write(20, 100, 4)] == [7, 0, 0]


# Faults of the line.


def line(faults, seed=1):
    return Line(Xl430(), parse_faults(ServoFaults, faults), seed)


def test_faults_of_one_seed_are_the_same_whatever_the_time_and_the_other_faults():
    packets = [packed(1, Do.STATUS, bytes([k])) for k in range(200)]
    alone, again, more = line("short=0.1"), line("short=0.1"), line("short=0.1,late=0.5:1")
    first = [alone.corrupted(p, 0.0)[1] for p in packets]
    assert first == [again.corrupted(p, 7.0)[1] for p in packets]
    assert first == [more.corrupted(p, 0.0)[1] for p in packets]
    assert 5 < sum(a != b for a, b in zip(first, packets, strict=True)) < 40


def test_a_corrupt_packet_never_has_a_good_checksum():
    spoiled = line("corrupt=1")
    for k in range(200):
        _, wire = spoiled.corrupted(packed(1, Do.STATUS, bytes([0, k])), 0.0)
        assert crc16(wire[:-2]) != int.from_bytes(wire[-2:], "little")


def test_silence_begins_and_ends_where_it_was_asked_to():
    quiet = line("silent=3:2")
    assert [len(quiet.corrupted(b"abc", 0.0)[1]) for _ in range(7)] == [3, 3, 3, 0, 0, 3, 3]


def test_a_dead_servo_neither_hears_nor_answers_and_its_watchdog_bites():
    dead = line("dead=4")
    ping = packed(1, Do.PING)
    assert [len(dead.receive(bytearray(ping), 0.1 * k)) for k in range(6)] == [1, 1, 1, 1, 0, 0]
    assert dead.servo._heard == pytest.approx(0.3)


def test_late_answers_come_late_and_in_order():
    late = line("late=0.5:0.5")
    when = [late.receive(bytearray(packed(1, Do.PING)), 0.01 * k)[0][0] for k in range(50)]
    assert when == sorted(when)
    assert any(t == pytest.approx(0.01 * k + 0.5) for k, t in enumerate(when))


@pytest.mark.parametrize("word", ["loud=1", "corrupt=x", "silent=3", "dead=", "late=0.1"])
def test_a_fault_that_cannot_be_is_one_sentence(word):
    with pytest.raises(SimulationError, match=r"give some of corrupt|lacks a number; write"):
        parse_faults(ServoFaults, word)
