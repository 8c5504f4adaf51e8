"""The simulated servo as a process, and clients that know nothing of us."""

import socket
import struct
import time

import numpy as np
import pytest

from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.dynamixel import Fault
from glissando.simulation import SimulationError
from servo_host import words


@pytest.fixture(scope="module")
def address():
    with started("servo", "--ids", "1", "2", "--backlash", "0", "--ends", "-1", "1") as path:
        yield path


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """On a busy machine the SDK waits for an answer, so that none comes late."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 2500)  # ms


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
    assert np.median(np.diff(told[:, 0])) == pytest.approx(0.005, abs=0.003)
    assert abs(told[-1, 0] - time.monotonic()) < 10.0


def test_a_device_that_does_not_start_is_one_sentence():
    with (
        pytest.raises(SimulationError, match=r"did not start: .*A servo has no fault 'loud'"),
        started("servo", "--faults", "loud=1"),
    ):
        pass
