"""The driver and the simulated stage in life: another process, its clock, and signals."""

import os
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from glissando.errors import DeviceError
from glissando.hardware.drivers import Slide
from glissando.hardware.simulated_devices import started
from slide_world import STAGE

pytestmark = pytest.mark.alone

PATIENCE = 1000  # ms: an answer of a simulated servo is waited for where the machine is busy


class Ear:
    """Listens to the stage's true travel."""

    def __init__(self):
        self.told = []  # (time, travel)
        self._news = threading.Condition()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while len(data := self._socket.recv(64)) == 16:
            with self._news:
                self.told.append(struct.unpack("<dd", data))
                self._news.notify()

    def after(self, time_):
        """What was told of the time since, once the last half second saw no motion; bounded."""
        end = time.monotonic() + 20.0
        while time.monotonic() < end:
            with self._news:
                self._news.wait(1.0)
                told = np.array([one for one in self.told if one[0] >= time_]).reshape(-1, 2)
            if len(told) > 100 and np.ptp(told[-100:, 1]) == 0.0:
                return told
        raise AssertionError("the stage still moves")

    def close(self):
        host, _, port = self.address.partition(":")
        self._socket.sendto(b"", (host, int(port)))
        self._thread.join(10.0)
        self._socket.close()


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", PATIENCE)


@pytest.fixture
def ear():
    heard = Ear()
    yield heard
    heard.close()


def simulated(ear, *more):
    return started("servo", "--travel", ear.address, "--backlash", "0", *more)


PROGRAM = f"""
    import sys
    from dynamixel_sdk import port_handler
    port_handler.LATENCY_TIMER = {PATIENCE}
    from glissando.hardware.drivers import Slide, Stage

    stage = Stage(lead=0.0254, stroke=(0.0, 0.06), speed=0.01, watchdog=1.0, lag=0.02)
    with Slide(sys.argv[1], stage) as slide:
        slide.home_here(0.0)
        for reading in slide.follow([0, 6], [0.0, 0.06]):
            if reading.travel > 0.005:
                print("moving", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_host_that_is_interrupted_or_killed_leaves_the_stage_standing(ear, number):
    from dynamixel_sdk import PacketHandler, PortHandler

    with simulated(ear) as address:
        command = [sys.executable, "-c", textwrap.dedent(PROGRAM), address]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=subprocess.DEVNULL, text=True) as host:
            assert host.stdout.readline() == "moving\n"
            os.kill(host.pid, number)
            host.wait(30.0)
            host.stdout.close()
        told = ear.after(time.monotonic() + 1.0)  # the watchdog has had its time
        assert 0.005 < told[-1, 1] < 0.05
        port, handler = PortHandler(address), PacketHandler(2.0)
        assert port.setBaudRate(57600)
        torque, watchdog = (_sound(handler, port, at) for at in (64, 98))
        port.closePort()
    assert (torque, watchdog) == ((0, 0) if number == signal.SIGINT else (1, 255))


def _sound(handler, port, at):
    for _ in range(10):
        value, result, _ = handler.read1ByteTxRx(port, 1, at)
        if result == 0:
            return value
    raise AssertionError(result)


@pytest.mark.slow
def test_in_life_a_move_takes_its_time_and_readings_are_true_at_their_stamps(ear):
    with simulated(ear, "--clock", "1.002", "--seed", "7") as address:
        with Slide(address, replace(STAGE, watchdog=1.0)) as slide:
            slide.home_here(0.0)
            readings = slide.move(0.06)
        told = ear.after(0.0)
    first, *_, last = np.flatnonzero(np.diff(told[:, 1]))
    # Between looks at it, which a busy machine makes rare, it began and ended to move.
    least, most = told[last, 0] - told[first + 1, 0], told[last + 1, 0] - told[first, 0]
    assert least - 0.03 < 2.5 + 0.24 < most + 0.03
    off = np.array([r.travel - np.interp(r.time, *told.T) for r in readings])
    assert np.median(np.abs(off)) < 3e-5
    stamps = np.array([(r.time, r.servo_time) for r in readings]).T
    rate, _ = np.polyfit(stamps[0] - stamps[0, 0], stamps[1], 1)
    assert rate == pytest.approx(1.002, abs=0.001)
    print(f"{len(readings)} readings, off by {1e6 * np.abs(off).max():.0f} um at most")


def test_a_port_that_is_not_there_is_one_sentence():
    with pytest.raises(DeviceError, match="cannot be opened"):
        Slide("/dev/no_such_port", STAGE).__enter__()


def test_a_port_that_goes_away_is_one_sentence():
    with started("servo") as address:
        slide = Slide(address, STAGE).__enter__()
        slide.home_here(0.0)
    with pytest.raises(DeviceError, match=r"is gone|did not answer"):
        slide.read()
    with pytest.raises(DeviceError):
        slide.__exit__(None, None, None)


def test_a_port_is_of_one_program():
    """Another one's set-up would switch the torque off."""
    with started("servo") as address, Slide(address, STAGE) as slide:
        slide.home_here(0.0)
        with pytest.raises(DeviceError, match="no other program has it"):
            Slide(address, STAGE).__enter__()
        assert slide.move(0.002)[-1].travel == pytest.approx(0.002, abs=1e-4)
