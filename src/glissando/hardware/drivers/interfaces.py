"""Interfaces of trackers and stages, independent of the manufacturer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

from numpy.typing import ArrayLike

from glissando.hardware.drivers.aurora_reply import Frame
from glissando.hardware.drivers.aurora_setup import Tool


@dataclass(frozen=True)
class SlideReading:
    """State of a stage at one instant.

    Attributes:
        time: Midpoint of the exchange, s of the host's monotonic clock.
        servo_time: Time of the device's own clock, unwrapped, s; equal to `time` if it has none.
        travel: Travel, m.
        speed: Speed, m/s.
        load: Fraction of the motor's maximum load, positive towards more travel; 0 if the device
            does not report it.
    """

    time: float
    servo_time: float
    travel: float
    speed: float
    load: float


class Tracker(Protocol):
    """A tracker that is read frame by frame: `IgtlTracker`, `Ros2Tracker`, `RemoteTracker`."""

    @property
    def tools(self) -> Sequence[Tool]:
        """Coils that are tracked at present."""

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of problems and frames, by name."""

    def read(self, timeout: float) -> Frame | None:
        """Wait for the next frame, with its time of measurement; None after a timeout.

        Args:
            timeout: Seconds to wait.

        Raises:
            DeviceError: The tracker failed.
        """


class LinearStage(Protocol):
    """A stage that slides a sensor: `Slide`, `GcodeSlide`, `RemoteSlide`; a context manager.

    Except in homing, nothing moves before the travel is known. Every method raises DeviceError if
    the device fails; the stage stops whenever the block ends, also by an exception.
    """

    @property
    def counts(self) -> Counter[str]:
        """Number of missing or corrupt answers, by name."""

    def __enter__(self) -> Self:
        """Open the device."""

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        """Stop the stage and close the device."""

    def home_here(self, travel: float) -> None:
        """Declare the present travel of the stage, m."""

    def home_at_stop(self) -> None:
        """Determine the travel with the stage's mechanical stop or switch."""

    def read(self) -> SlideReading:
        """Present state of the stage."""

    def move(self, travel: float) -> Sequence[SlideReading]:
        """Go to a travel in metres; the readings on the way."""

    def follow(self, time: ArrayLike, travel: ArrayLike) -> Iterator[SlideReading]:
        """Follow a path of travels (K,) m at times (K,) s, of which the first is the present."""

    def pursue(self, wanted: Callable[[float], float], lasts: float) -> Iterator[SlideReading]:
        """Follow a function of time for `lasts` s: travel in m at a time in s from now."""

    def stop(self) -> None:
        """Stop at once."""

    def abort(self) -> None:
        """End the motion that another thread waits for, in which DeviceError is then raised."""
