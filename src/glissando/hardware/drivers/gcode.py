"""A stage that a GRBL controller drives: steps and direction by G-code over a serial line.

Motions are jogs ($J=) in machine coordinates (G53). A jog cancel (0x85) is a feed hold that drops
all further jogs and keeps the position; a host that dies leaves at most the few that are on their
way, some hundredths of a second.
"""

from __future__ import annotations

from time import monotonic, sleep
from typing import Self

from glissando.errors import DeviceError
from glissando.hardware.drivers.gcode_line import GcodeLine
from glissando.hardware.drivers.gcode_stage import GcodeStage
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.position_slide import PositionSlide, StandingError

_MM = 1e3
_MINUTE = 60.0
_HOMING = 120.0  # s for a homing cycle
_PATIENCE = 2.0  # s for a motion to stop
_PACE = 0.02  # s between looks whether it has


class GcodeSlide(PositionSlide):
    """A stage on a GRBL controller, to be used in a with-block; it stands still afterwards.

    Args:
        address: Serial path, or tcp://host:port.
        stage: Its limits and its axis.

    Raises:
        DeviceError: From any method: the controller does not answer, refuses, raises an alarm, or
            the travel is not known yet.
    """

    stage: GcodeStage

    def __init__(self, address: str, stage: GcodeStage) -> None:
        super().__init__(stage)
        self.address = address
        self._open: GcodeLine | None = None
        self._homing = False

    def __enter__(self) -> Self:
        self._open = GcodeLine(self.address, self.stage, self.counts, self._forget)
        return self

    def _close(self) -> None:
        self._forget()
        if self._open is not None:
            self._open.close()
            self._open = None

    @property
    def _line(self) -> GcodeLine:
        if self._open is None:
            raise DeviceError("The slide is not open: use it as `with GcodeSlide(…) as slide:`.")
        return self._open

    def home_here(self, travel: float) -> None:
        """Declare the stage's travel now, in metres; an alarm of a missing homing is unlocked."""
        self.stage.require_inside(travel)
        if self._line.status()[0] == "Alarm":
            self._line.send("$X")
        super().home_here(travel)

    def _home_place(self) -> float:
        self._homing = True
        try:
            self._line.send("$H", _HOMING)
        finally:
            self._homing = False
        return self._standing_place()

    def abort(self) -> None:
        """End the motion that another thread waits for; a controller that homes is reset."""
        super().abort()
        if self._homing:
            self._line.reset()

    def _place(self) -> tuple[float, float]:
        sent = monotonic()
        state, position = self._line.status()
        if state in ("Alarm", "Door", "Sleep"):
            self._forget()
            raise DeviceError(
                f"The controller at {self.address} is in state {state} and its position is not "
                f"sure; clear the cause and home again."
            )
        return 0.5 * (sent + monotonic()), position / _MM

    def _aim(self, place: float, speed: float) -> None:
        feed = max(_MM * _MINUTE * speed, 1.0)
        self._line.send(f"$J=G53G90G21{self.stage.axis}{_MM * place:.4f}F{feed:.1f}")

    def _stands(self, reading: SlideReading) -> bool:
        return self._line.status()[0] == "Idle"

    def stop(self) -> None:
        """Stand still at once; the position stays known.

        A controller that homes heeds no cancel, and may not even answer: it is reset, as is one
        that does not stop or does not say whether it has.
        """
        line, end = self._line, monotonic() + _PATIENCE
        while True:
            line.cancel()  # again and again: one that comes between two jogs has no effect
            try:
                state = line.status()[0]
            except StandingError:
                raise
            except DeviceError:
                self._reset()
                raise
            if state not in ("Jog", "Run", "Hold", "Home"):
                return
            if state == "Home" or monotonic() > end:
                self._reset()
                raise DeviceError("The stage did not stop and was reset; home it again.")
            sleep(_PACE)

    def _reset(self) -> None:
        """End whatever the controller does, with which it may lose its position."""
        self._forget()
        self._line.reset()
