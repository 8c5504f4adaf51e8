"""A stage to drive in a world without waiting, and worlds that meddle and interrupt."""

from glissando.hardware.drivers import Slide, Stage
from glissando.hardware.simulated_devices.dynamixel import Do, packed
from servo_world import World

STAGE = Stage(lead=0.0254, stroke=(0.0, 0.06), home=-0.002)
TICK = STAGE.lead / 4096


def home(world, stage=STAGE):
    """An open slide that knows where it is; the world's true travel."""
    slide = Slide("world", stage).__enter__()
    slide.home_here(world.screw.travel)
    return slide


class Meddled(World):
    """A world in which somebody else switches the torque off after so many packets."""

    meddles = None

    def writePort(self, packet):  # noqa: N802
        if self.heard == self.meddles:
            self.servo.receive(packed(1, Do.WRITE, bytes([64, 0, 0])), self.now)
        return super().writePort(packet)


class Interrupted(BaseException):
    """As KeyboardInterrupt, which would end the tests."""


class Fused(World):
    """A world in which an interrupt may come at any byte."""

    fuse = None

    def readPort(self, length):  # noqa: N802
        if self.fuse is not None and self.heard >= self.fuse:
            self.fuse = None
            raise Interrupted
        return super().readPort(length)


def moved_from_zero(world, stage=STAGE):
    """Home at 0 and move to 60 mm, in a block of its own."""
    with Slide("w", stage) as slide:
        slide.home_here(0.0)
        slide.move(0.06)
