"""The simulated servo's registers: what may be written, and who is answered."""

import pytest

from glissando.hardware.simulated_devices.dynamixel import BROADCAST, Do, Fault, packed
from glissando.hardware.simulated_devices.xl430 import Xl430
from servo_host import Host, words


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
