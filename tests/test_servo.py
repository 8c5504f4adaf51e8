"""The simulated servo: its protocol byte by byte, its registers, its motion, and real clients."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from draws import law
from glissando.errors import DeviceError
from glissando.simulate import SimulationError
from glissando.simulate.devices import started
from glissando.simulate.devices.dynamixel import ALERT, BROADCAST, Bus, Do, Fault, crc16, packed
from glissando.simulate.devices.profile import at_speed, to
from glissando.simulate.devices.screw import Screw
from glissando.simulate.devices.servo import Stage
from glissando.simulate.devices.servo_faults import Faults, Line
from glissando.simulate.devices.xl430 import ACCELERATION_UNIT, OVERLOAD, SPEED_UNIT, Xl430

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


def words(*pairs):
    """Numbers, each (value, bytes), as they stand in a packet."""
    return b"".join((v % (1 << 8 * n)).to_bytes(n, "little") for v, n in pairs)


class Host:
    """A host that is never wrong, and a clock of its own."""

    def __init__(self, *servos):
        self.servos = servos or (Xl430(),)
        self.bus = Bus(self.servos)
        self.now = 1.0

    def says(self, data):
        return self.bus.receive(data, self.now)

    def tells(self, instruction, parameters=b"", identity=1):
        """Error and parameters of the only answer."""
        (status,) = self.says(packed(identity, instruction, parameters))
        assert crc16(status[:-2]) == int.from_bytes(status[-2:], "little")
        assert status[4] == identity
        body = status[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return body[0], body[1:]

    def writes(self, address, value, size, identity=1):
        return self.tells(Do.WRITE, words((address, 2), (value, size)), identity)[0]

    def reads(self, address, size, identity=1):
        error, data = self.tells(Do.READ, words((address, 2), (size, 2)), identity)
        assert error & ~ALERT == 0
        assert len(data) == size
        return int.from_bytes(data, "little", signed=size == 4)

    def extended(self, **registers):
        """Extended position mode with torque on."""
        assert self.writes(11, 4, 1) == 0
        for name, value in registers.items():
            address = {"velocity": 112, "acceleration": 108, "offset": 20}[name]
            assert self.writes(address, value, 4) == 0
        assert self.writes(64, 1, 1) == 0
        return self


# Packets.


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


# Registers.


def test_a_new_servo_is_an_xl430_in_position_mode_without_torque():
    host = Host()
    assert host.tells(Do.PING) == (0, words((1060, 2), (45, 1)))
    assert [host.reads(at, size) for at, size in ((11, 1), (64, 1), (44, 4), (8, 1))] == [
        3,
        0,
        265,
        1,
    ]


@pytest.mark.parametrize(
    ("address", "value", "size", "fault"),
    [
        (0, 1, 2, Fault.ACCESS),  # read only
        (132, 1, 4, Fault.ACCESS),
        (14, 1, 1, Fault.ACCESS),  # nothing there
        (116, 1, 2, Fault.LENGTH),  # half a register
        (117, 1, 1, Fault.ACCESS),
        (11, 2, 1, Fault.RANGE),
        (11, 17, 1, Fault.RANGE),
        (112, 266, 4, Fault.LIMIT),  # beyond the velocity limit
        (116, 4096, 4, Fault.LIMIT),  # beyond one turn in position mode
        (100, 886, 2, Fault.RANGE),
    ],
)
def test_what_must_not_be_written_is_refused_and_nothing_changes(address, value, size, fault):
    host = Host()
    before = bytes(host.servos[0].table._bytes)
    assert host.writes(address, value, size) == fault
    assert bytes(host.servos[0].table._bytes) == before


def test_a_write_over_several_registers_is_all_or_nothing():
    host = Host()
    good = words((108, 2), (5, 4), (100, 4), (2000, 4))
    assert host.tells(Do.WRITE, good)[0] == 0
    assert [host.reads(at, 4) for at in (108, 112, 116)] == [5, 100, 2000]
    assert host.tells(Do.WRITE, words((108, 2), (6, 4), (999, 4), (2001, 4)))[0] == Fault.LIMIT
    assert [host.reads(at, 4) for at in (108, 112, 116)] == [5, 100, 2000]


def test_the_eeprom_is_locked_while_torque_is_on():
    host = Host().extended()
    assert host.writes(20, 100, 4) == Fault.ACCESS
    assert host.writes(64, 0, 1) == 0
    assert host.writes(20, 100, 4) == 0


@pytest.mark.parametrize(("level", "answers"), [(0, [1, 0, 0]), (1, [1, 1, 0]), (2, [1, 1, 1])])
def test_the_status_return_level_says_who_is_answered(level, answers):
    host = Host()
    host.servos[0].table["status_return"] = level
    asked = [(Do.PING, b""), (Do.READ, words((132, 2), (4, 2))), (Do.WRITE, words((65, 2), (1, 1)))]
    assert [len(host.says(packed(1, *one))) for one in asked] == answers
    assert host.servos[0].table["led"] == 1  # done all the same


def test_a_registered_write_waits_for_its_action():
    host = Host()
    assert host.tells(Do.REG_WRITE, words((65, 2), (1, 1)))[0] == 0
    assert (host.reads(65, 1), host.reads(69, 1)) == (0, 1)
    assert host.tells(Do.ACTION)[0] == 0
    assert (host.reads(65, 1), host.reads(69, 1)) == (1, 0)
    assert host.tells(Do.ACTION)[0] == Fault.RESULT


def test_indirect_addresses_lead_to_the_registers_they_name():
    host = Host()
    for k in range(4):
        assert host.writes(168 + 2 * k, 116 + k, 2) == 0
    assert host.writes(224, 1234, 4) == 0
    assert host.reads(116, 4) == host.reads(224, 4) == 1234


def test_servos_on_one_bus_answer_a_sync_read_in_the_order_asked():
    host = Host(*(Xl430(identity=k) for k in (1, 2, 3)))
    answers = host.says(packed(BROADCAST, Do.SYNC_READ, words((7, 2), (1, 2)) + bytes([3, 1])))
    assert [(a[4], a[9]) for a in answers] == [(3, 3), (1, 1)]
    bulk = b"".join(words((k, 1), (7, 2), (1, 2)) for k in (2, 1))
    assert [a[9] for a in host.says(packed(BROADCAST, Do.BULK_READ, bulk))] == [2, 1]


def test_servos_on_one_bus_take_their_own_of_a_sync_and_a_bulk_write():
    host = Host(*(Xl430(identity=k) for k in (1, 2)))
    goals = words((116, 2), (4, 2), (1, 1), (111, 4), (2, 1), (222, 4))
    assert host.says(packed(BROADCAST, Do.SYNC_WRITE, goals)) == []
    assert [host.reads(116, 4, k) for k in (1, 2)] == [111, 222]
    mixed = words((1, 1), (65, 2), (1, 2), (1, 1), (2, 1), (116, 2), (4, 2), (333, 4))
    assert host.says(packed(BROADCAST, Do.BULK_WRITE, mixed)) == []
    assert (host.reads(65, 1), host.reads(116, 4, 2)) == (1, 333)


def test_a_factory_reset_keeps_what_it_is_asked_to_keep():
    host = Host(Xl430(identity=5))
    host.writes(8, 3, 1, identity=5)
    assert host.tells(Do.FACTORY_RESET, b"\x02", identity=5)[0] == 0
    host.now += 1.0
    assert (host.reads(8, 1, 5), host.reads(11, 1, 5)) == (3, 3)
    host.tells(Do.FACTORY_RESET, b"\xff", identity=5)
    host.now += 1.0
    assert host.reads(8, 1) == 1


# Motion.


def stepped(position, speed, goal, top, acceleration, dt=1e-5):
    """The obvious twin: full throttle as long as it can still brake in time, in small steps."""
    for _ in range(10_000_000):
        way = goal - position
        if abs(way) < 2.0 * top * dt and abs(speed) < 4.0 * acceleration * dt:
            return
        wanted = np.sign(way) * min(top, np.sqrt(2.0 * acceleration * abs(way)))
        change = np.clip(wanted - speed, -acceleration * dt, acceleration * dt)
        position += (speed + 0.5 * change) * dt
        speed += change
        yield position, speed


@pytest.mark.parametrize(
    ("speed_now", "goal", "top", "acceleration"),
    [
        (0.0, 3.0, 1.0, 2.0),  # trapezoid
        (0.0, -0.3, 1.0, 2.0),  # triangle
        (0.8, 3.0, 1.0, 2.0),  # already on its way
        (1.5, 3.0, 1.0, 2.0),  # too fast
        (-0.9, 0.5, 1.0, 2.0),  # the wrong way
        (1.0, 0.1, 1.0, 2.0),  # too late to stop: there and back
    ],
)
def test_a_profile_is_what_small_steps_of_full_throttle_give(speed_now, goal, top, acceleration):
    profile = to(0.0, 0.0, speed_now, goal, speed=top, acceleration=acceleration)
    dt = 1e-4
    steps = list(stepped(0.0, speed_now, goal, top, acceleration, dt))
    mine = [profile.at(dt * (k + 1)) for k in range(len(steps))]
    assert np.abs(np.array(mine) - np.array(steps)).max() < 0.02
    assert profile.duration == pytest.approx(dt * len(steps), abs=0.03)


sizes = st.floats(1.0, 1e4)
signed = st.floats(-1e4, 1e4)


@law
@given(signed, signed, signed, sizes, sizes)
def test_profiles_end_at_rest_at_their_goal_within_their_limits(start, now, goal, top, sharp):
    profile = to(2.0, start, now, goal, speed=top, acceleration=sharp)
    time = 2.0 + np.linspace(0.0, profile.duration, 2001)
    place, speed = np.array([profile.at(t) for t in time]).T
    assert profile.at(time[-1] + 1.0) == (pytest.approx(goal, abs=1e-6), 0.0)
    assert np.abs(speed).max() <= max(top, abs(now)) * (1 + 1e-9)
    step = time[1] - time[0]
    assert np.abs(np.diff(speed)).max() <= sharp * step * (1 + 1e-6) + 1e-6
    assert np.allclose(np.diff(place), 0.5 * step * (speed[1:] + speed[:-1]), atol=sharp * step**2)


@law
@given(st.floats(0.5, 60.0), st.integers(1, 265), st.integers(1, 500))
def test_a_trapezoid_lasts_as_long_as_its_closed_form(turns, velocity, acceleration):
    top, sharp = SPEED_UNIT * velocity, ACCELERATION_UNIT * acceleration
    way = 4096.0 * turns
    reached = min(top, np.sqrt(way * sharp))
    profile = to(0.0, 0.0, 0.0, way, speed=top, acceleration=sharp)
    assert profile.duration == pytest.approx(way / reached + reached / sharp, rel=1e-9)
    t1 = 0.064 * velocity / acceleration  # s, the manual's time of acceleration
    if reached == top:
        assert profile.at(t1)[1] == pytest.approx(top, rel=2e-3)


def test_without_acceleration_a_profile_is_a_rectangle():
    profile = to(0.0, 0.0, 5.0, 10.0, speed=2.0, acceleration=0.0)
    assert [profile.at(t) for t in (0.0, 2.5, 5.0)] == [(0, 2), (5, 2), (10, 0)]


def test_a_constant_speed_is_reached_and_kept():
    profile = at_speed(0.0, 0.0, 0.0, -4.0, acceleration=2.0)
    assert profile.at(1.0) == (-1.0, -2.0)
    assert profile.at(102.0) == (-404.0, -4.0)


def test_a_goal_is_reached_in_the_time_of_its_registers():
    host = Host().extended(velocity=248, acceleration=66)
    start = host.reads(132, 4)
    host.writes(116, start + 9676, 4)  # 60 mm of a 25.4 mm lead
    begun = host.now
    while host.reads(122, 1) or host.reads(128, 4) or host.now == begun:
        host.now += 0.001
    assert host.now - begun == pytest.approx(2.5 + 0.24, abs=0.01)
    assert abs(host.reads(132, 4) - start - 9676) <= 1


def test_a_profile_velocity_of_zero_is_as_fast_as_the_motor_can():
    host = Host().extended()
    host.writes(116, 4096, 4)
    host.now += 0.5
    assert host.reads(128, 4) == 265


def test_a_restart_loses_the_turns_but_not_the_angle():
    host = Host(Xl430(Screw(ends=(-1.0, 1.0)))).extended()
    host.writes(116, 10_000, 4)
    host.now += 5.0
    assert host.reads(132, 4) == 10_000
    assert host.tells(Do.REBOOT)[0] == 0
    assert host.says(packed(1, Do.PING)) == []  # it takes a moment
    host.now += 1.0
    assert host.reads(132, 4) == 10_000 % 4096
    assert (host.reads(64, 1), host.reads(11, 1), host.reads(120, 2)) == (0, 4, 1000)


def test_clearing_the_turns_waits_for_a_standstill():
    host = Host(Xl430(Screw(ends=(-1.0, 1.0)))).extended(velocity=100)
    clear = bytes.fromhex("01 44 58 4c 22")
    host.writes(116, 10_000, 4)
    host.now += 0.5
    assert host.tells(Do.CLEAR, clear)[0] == Fault.RESULT
    host.now += 20.0
    assert host.tells(Do.CLEAR, clear)[0] == 0
    assert host.reads(132, 4) == 10_000 % 4096


def test_the_servo_ticks_milliseconds_and_wraps():
    host = Host(Xl430(now=1.0, tick=32_000))
    assert host.reads(120, 2) == 32_000
    host.now += 0.7675
    assert host.reads(120, 2) == 32_767
    host.now += 0.001
    assert host.reads(120, 2) == 0


def test_silence_longer_than_the_watchdog_stops_the_motion():
    host = Host().extended(velocity=100)
    assert host.writes(98, 10, 1) == 0  # 200 ms
    host.writes(116, 9000, 4)
    for _ in range(10):
        host.now += 0.19
        assert host.reads(128, 4) == 100
    host.now += 0.21
    place = host.reads(132, 4)
    host.now += 5.0
    assert (host.reads(132, 4), host.reads(98, 1)) == (place, 255)
    assert host.writes(116, 9000, 4) == Fault.RANGE
    assert host.writes(98, 0, 1) == 0
    assert host.writes(116, place + 100, 4) == 0


def test_the_watchdog_of_older_firmware_runs_away_with_a_homing_offset():
    host = Host(Xl430(Screw(ends=(-1.0, 1.0)))).extended(velocity=100, offset=1000)
    host.writes(98, 10, 1)
    place = host.reads(132, 4)
    host.now += 5.0
    assert host.reads(132, 4) == pytest.approx(place - 1000, abs=1)


def test_an_overload_takes_the_torque_and_only_a_restart_gives_it_back():
    host = Host().extended(velocity=100)
    host.writes(116, 100_000, 4)
    for _ in range(2000):
        host.now += 0.01
        host.servos[0].advance(host.now)
    assert host.servos[0].screw.travel == pytest.approx(0.062)
    error, data = host.tells(Do.READ, words((70, 2), (1, 2)))
    assert (error, data) == (ALERT, bytes([OVERLOAD]))
    assert host.reads(64, 1) == 0
    assert host.writes(64, 1, 1) == ALERT | Fault.RESULT
    host.tells(Do.REBOOT)
    host.now += 1.0
    assert host.writes(64, 1, 1) == 0


def test_a_gentle_push_against_a_stop_is_no_overload():
    host = Host().extended(velocity=100)
    host.writes(100, 200, 2)
    host.writes(116, 100_000, 4)
    for _ in range(2000):
        host.now += 0.01
        host.servos[0].advance(host.now)
    assert host.reads(70, 1) == 0
    assert host.reads(126, 2) == 225  # a load of 200 / 885


# The screw.


@law
@given(
    st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=30),
    st.floats(0.0, 1e-3),
    st.sampled_from([1.0, -1.0]),
)
def test_the_carriage_follows_its_nut_within_the_play_and_never_moves_against_it(
    angles, play, direction
):
    screw = Screw(lead=0.0254, direction=direction, play=play, start=0.03)
    before_nut = before = 0.03
    for angle in angles:
        travel = screw.turn(angle)
        nut = 0.03 + direction * 0.0254 * angle / 4096.0
        assert abs(travel - nut) <= 0.5 * play + 1e-12
        assert (travel - before) * (nut - before_nut) >= 0.0
        before, before_nut = travel, nut


def test_there_and_back_loses_the_play():
    screw = Screw(play=1e-4, start=0.0)
    away = screw.turn(4096.0)
    assert screw.turn(4096.0 - 4096.0 * 1e-4 / 0.0254) == pytest.approx(away)
    assert screw.turn(0.0) == pytest.approx(0.5e-4)


# Faults.


def line(*faults, seed=1):
    return Line(Faults.read(faults), seed)


def test_faults_of_one_seed_are_the_same_whatever_the_time_and_the_other_faults():
    packets = [packed(1, Do.STATUS, bytes([k])) for k in range(200)]
    alone, again, more = line("short=0.1"), line("short=0.1"), line("short=0.1", "late=0.5:1")
    first = [alone.spoil(p, 0.0)[1] for p in packets]
    assert first == [again.spoil(p, 7.0)[1] for p in packets]
    assert first == [more.spoil(p, 0.0)[1] for p in packets]
    assert 5 < sum(a != b for a, b in zip(first, packets, strict=True)) < 40


def test_a_corrupt_packet_never_has_a_good_checksum():
    spoiled = line("corrupt=1")
    for k in range(200):
        _, wire = spoiled.spoil(packed(1, Do.STATUS, bytes([0, k])), 0.0)
        assert crc16(wire[:-2]) != int.from_bytes(wire[-2:], "little")


def test_silence_begins_and_ends_where_it_was_said_to():
    quiet = line("silent=3:2")
    assert [len(quiet.spoil(b"abc", 0.0)[1]) for _ in range(7)] == [3, 3, 3, 0, 0, 3, 3]


def test_a_dead_servo_neither_hears_nor_answers_and_its_watchdog_bites():
    stage = Stage(Xl430(), [], line("dead=4"))
    ping = packed(1, Do.PING)
    told = []
    for k in range(6):
        stage.hear(ping, 0.1 * k)
        told.append(len(stage.say(0.1 * k)))
    assert told == [14, 14, 14, 14, 0, 0]
    assert stage.servo._heard == pytest.approx(0.3)


def test_late_answers_come_late_and_in_order():
    stage = Stage(Xl430(), [], line("late=1:0.5"))
    stage.hear(packed(1, Do.PING), 1.0)
    assert stage.next_due == 1.5
    assert (len(stage.say(1.49)), len(stage.say(1.5))) == (0, 14)


@pytest.mark.parametrize("word", ["loud=1", "corrupt=x", "silent=3", "dead=", "late=0.1:-1"])
def test_a_fault_that_cannot_be_is_one_sentence(word):
    with pytest.raises(DeviceError, match="give some of corrupt=P"):
        Faults.read([word])


# Clients that know nothing of us.


@pytest.fixture(scope="module")
def address():
    with started("servo", "--ids", "1", "2", "--backlash", "0", "--ends", "-1", "1") as path:
        yield path


@pytest.fixture
def sdk(address):
    from dynamixel_sdk import PacketHandler, PortHandler

    port = PortHandler(address)
    assert port.setBaudRate(57600)
    yield port, PacketHandler(2.0)
    port.closePort()


def sound(call, *arguments):
    """What a call of the SDK gives when all is well; asked again if a busy machine was slow."""
    for _ in range(5):
        *value, result, error = call(*arguments)
        if result == 0:
            assert error == 0
            return value[0] if value else None
    raise AssertionError(result)


def test_the_official_sdk_pings_reads_and_writes(sdk):
    port, handler = sdk
    assert sound(handler.ping, port, 1) == 1060
    assert sound(handler.write1ByteTxRx, port, 1, 65, 1) is None
    assert sound(handler.read1ByteTxRx, port, 1, 65) == 1
    assert handler.write2ByteTxRx(port, 1, 0, 7) == (0, Fault.ACCESS)
    sound(handler.regWriteTxRx, port, 1, 65, 1, [0])
    handler.action(port, 1)
    end = time.monotonic() + 10.0  # the SDK leaves the action's answer on the line
    while sound(handler.read1ByteTxRx, port, 1, 65) and time.monotonic() < end:
        pass
    assert sound(handler.read1ByteTxRx, port, 1, 65) == 0


def test_the_official_sdk_finds_every_servo_by_a_broadcast(sdk):
    port, handler = sdk
    found, result = handler.broadcastPing(port)
    assert (result, found) == (0, {1: [1060, 45], 2: [1060, 45]})


def test_the_official_sdk_reads_and_writes_in_groups(sdk):
    from dynamixel_sdk import GroupBulkRead, GroupBulkWrite, GroupSyncRead, GroupSyncWrite

    write = GroupSyncWrite(*sdk, 112, 4)
    read = GroupSyncRead(*sdk, 112, 4)
    for k in (1, 2):
        write.addParam(k, words((40 + k, 4)))
        read.addParam(k)
    assert write.txPacket() == 0
    assert any(read.txRxPacket() == 0 for _ in range(5))
    assert [read.getData(k, 112, 4) for k in (1, 2)] == [41, 42]
    write, read = GroupBulkWrite(*sdk), GroupBulkRead(*sdk)
    write.addParam(1, 65, 1, words((1, 1)))
    write.addParam(2, 108, 4, words((9, 4)))
    read.addParam(1, 65, 1)
    read.addParam(2, 108, 4)
    assert write.txPacket() == 0
    assert any(read.txRxPacket() == 0 for _ in range(5))
    assert (read.getData(1, 65, 1), read.getData(2, 108, 4)) == (1, 9)


def test_the_easy_sdk_turns_the_simulated_motor(address):
    easy = pytest.importorskip("dynamixel_easy_sdk")
    connector = easy.Connector(address, 57600)
    try:
        motor = connector.createMotor(2)
        motor.disableTorque()
        motor.setOperatingMode(easy.OperatingMode.EXTENDED_POSITION)
        motor.enableTorque()
        motor.setGoalPosition(-600)
        end = time.monotonic() + 10.0
        while motor.getPresentPosition() != -600 and time.monotonic() < end:
            pass
        assert motor.getPresentPosition() == -600
        motor.disableTorque()
    finally:
        connector.closePort()


def test_true_travel_is_told_200_times_a_second():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(10.0)
        goal = f"127.0.0.1:{ear.getsockname()[1]}"
        with started("servo", "--travel", goal, "--start", "0.01"):
            told = np.array([struct.unpack("<dd", ear.recv(64)) for _ in range(100)])
    assert np.all(told[:, 1] == 0.01)
    assert np.median(np.diff(told[:, 0])) == pytest.approx(0.005, abs=0.002)
    assert abs(told[-1, 0] - time.monotonic()) < 10.0


def test_a_device_that_does_not_start_is_one_sentence():
    with (
        pytest.raises(SimulationError, match=r"did not start: .*A servo has no fault 'loud'"),
        started("servo", "--faults", "loud=1"),
    ):
        pass
