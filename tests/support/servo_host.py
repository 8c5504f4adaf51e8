"""A host of the simulated servo that is never wrong, with a clock of its own."""

from glissando.hardware.simulated_devices.dynamixel import ALERT, Bus, Do, crc16, packed
from glissando.hardware.simulated_devices.xl430 import Xl430


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
