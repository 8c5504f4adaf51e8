"""The simulated servo as a process, and clients that know nothing of us."""

import socket
import time

import numpy as np
import pytest

from glissando.hardware.simulated_devices import started
from glissando.hardware.simulated_devices.dynamixel import Fault
from glissando.hardware.simulated_devices.travel import MESSAGE
from glissando.simulation import SimulationError


@pytest.fixture(scope="module")
def address():
    with started("servo", "--backlash", "0", "--ends", "-1", "1") as path:
        yield path


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """On a busy machine the SDK waits for an answer, so that none comes late."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 2500)  # ms


def sound(call, *arguments):
    """What a call of the SDK gives when all is well; asked again if a busy machine was slow."""
    for _ in range(5):
        *value, result, error = call(*arguments)
        if result == 0:
            assert error == 0
            return value[0] if value else None
    raise AssertionError(result)


def test_the_official_sdk_pings_reads_and_writes(address):
    from dynamixel_sdk import PacketHandler, PortHandler

    port, handler = PortHandler(address), PacketHandler(2.0)
    assert port.setBaudRate(57600)
    assert sound(handler.ping, port, 1) == 1060
    assert sound(handler.write1ByteTxRx, port, 1, 65, 1) is None
    assert sound(handler.read1ByteTxRx, port, 1, 65) == 1
    assert handler.write2ByteTxRx(port, 1, 0, 7) == (0, Fault.ACCESS)
    port.closePort()


@pytest.mark.slow
def test_the_easy_sdk_turns_the_simulated_motor(address):
    easy = pytest.importorskip("dynamixel_easy_sdk")
    connector = easy.Connector(address, 57600)
    try:
        motor = connector.createMotor(1)
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


@pytest.mark.slow
def test_true_travel_is_sent_200_times_a_second():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(10.0)
        goal = f"127.0.0.1:{ear.getsockname()[1]}"
        with started("servo", "--travel", goal, "--start", "0.01"):
            sent = np.array([MESSAGE.unpack(ear.recv(64)) for _ in range(100)])
    assert np.all(sent[:, 1] == 0.01)
    assert np.median(np.diff(sent[:, 0])) == pytest.approx(0.005, abs=0.003)
    assert abs(sent[-1, 0] - time.monotonic()) < 10.0


def test_a_device_that_does_not_start_is_one_sentence():
    with (
        pytest.raises(SimulationError, match=r"did not start: 'loud' is not a fault"),
        started("servo", "--faults", "loud=1"),
    ):
        pass
