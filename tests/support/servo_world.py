"""The driver and the simulated servo in one process, on a clock that only they move.

A hundred times faster than life and the same every time: the SDK's packet handler talks to a port
that hands its bytes to the simulator and lets a little time pass with every call.
"""

from contextlib import ExitStack, contextmanager
from unittest import mock

from dynamixel_sdk import PacketHandler

from glissando.hardware.drivers import dynamixel, homing, slide
from glissando.hardware.simulated_devices.faults import parse_faults
from glissando.hardware.simulated_devices.screw import Screw
from glissando.hardware.simulated_devices.servo import Line, ServoFaults
from glissando.hardware.simulated_devices.xl430 import Xl430

_SENDING, _WAITING = 0.0015, 0.001  # s


class World:
    """A stage, its true travel at every moment that was looked at, and the port to it."""

    def __init__(self, *faults, start=0.03, angle=1234.5, play=0.0, **screw):
        self.now = 100.0
        self.screw = Screw(start=start, angle=angle, play=play, **screw)
        self.servo = Xl430(self.screw, now=self.now, tick=30_000)
        self.line = Line(self.servo, parse_faults(ServoFaults, ",".join(faults)), seed=3)
        self.travel = [(self.now, start)]
        self.heard = 0  # times anything was sent
        self.answers = []  # (time, answers until then)
        self._due = []  # (time, bytes) on their way to the host
        # What the SDK asks of a port.
        self.is_using = self.is_open = False
        self._bytes, self._deadline = b"", 0.0

    def passes(self, seconds):
        end = self.now + seconds
        while self.now < end:
            self.now = min(self.now + 0.005, end)
            self.travel.append((self.now, self.servo.advance(self.now)))

    def arrived(self):
        """The bytes that have come to the host by now."""
        arrived = b"".join(data for when, data in self._due if when <= self.now)
        self._due = [(when, data) for when, data in self._due if when > self.now]
        return arrived

    def writePort(self, packet):  # noqa: N802
        self.passes(_SENDING)
        self.heard += 1
        self._due += self.line.receive(bytearray(packet), self.now)
        self.answers.append((self.now, self.line.sent))
        return len(packet)

    def readPort(self, length):  # noqa: N802
        self.passes(_WAITING)
        self._bytes += self.arrived()
        out, self._bytes = self._bytes[:length], self._bytes[length:]
        return list(out)

    def clearPort(self):  # noqa: N802
        self.arrived()
        self._bytes = b""

    def setPacketTimeout(self, length):  # noqa: N802
        self._deadline = self.now + 0.034 + 10.0 * length / 57600

    def isPacketTimeout(self):  # noqa: N802
        return self.now > self._deadline

    def closePort(self):  # noqa: N802
        pass


@contextmanager
def together(world):
    """Inside, every Slide drives this world on its clock."""

    def clock():
        return world.now

    with ExitStack() as stack:
        port = mock.Mock(return_value=(world, PacketHandler(2.0)))
        stack.enter_context(mock.patch.object(dynamixel, "opened", port))
        for module in (dynamixel, homing, slide):
            stack.enter_context(mock.patch.object(module, "monotonic", clock))
        for module in (homing, slide):
            stack.enter_context(mock.patch.object(module, "sleep", world.passes))
        yield
