"""Faults of the simulated line: the same for one seed, and those that were asked for."""

import pytest

from glissando.errors import DeviceError
from glissando.hardware.simulated_devices.dynamixel import Do, crc16, packed
from glissando.hardware.simulated_devices.servo import Stage
from glissando.hardware.simulated_devices.servo_faults import Faults, Line
from glissando.hardware.simulated_devices.xl430 import Xl430


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
