"""A host of the simulated servo that makes no mistakes, with a clock of its own."""

from glissando.hardware.simulated_devices.dynamixel import ALERT, Do, crc16, packed
from glissando.hardware.simulated_devices.xl430 import Xl430


def words(*pairs):
    """Numbers, each (value, bytes), as they stand in a packet."""
    return b"".join((v % (1 << 8 * n)).to_bytes(n, "little") for v, n in pairs)


class Host:
    """A servo's host; its clock `now` moves only when the test moves it."""

    def __init__(self, servo=None):
        self.servo = servo or Xl430()
        self.now = 1.0

    def send(self, data):
        return self.servo.receive(data, self.now)

    def ask(self, instruction, parameters=b"", identity=1):
        """Error and parameters of the only answer."""
        (status,) = self.send(packed(identity, instruction, parameters))
        assert crc16(status[:-2]) == int.from_bytes(status[-2:], "little")
        assert status[4] == identity
        body = status[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return body[0], body[1:]

    def write(self, address, value, size):
        return self.ask(Do.WRITE, words((address, 2), (value, size)))[0]

    def read(self, address, size):
        error, data = self.ask(Do.READ, words((address, 2), (size, 2)))
        assert error & ~ALERT == 0
        assert len(data) == size
        return int.from_bytes(data, "little", signed=size == 4)

    def extended(self, **registers):
        """Extended position mode with torque on."""
        assert self.write(11, 4, 1) == 0
        for name, value in registers.items():
            assert self.write({"velocity": 112, "acceleration": 108}[name], value, 4) == 0
        assert self.write(64, 1, 1) == 0
        return self
