"""What a tracker and a stage must do, whoever made them."""

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
    """State of a stage at one moment.

    Attributes:
        time: Middle of the exchange, s of the host's monotonic clock.
        servo_time: The device's own clock, which never wraps here, s; `time` if it has none.
        travel: Travel, m.
        speed: Speed, m/s.
        load: Share of the motor's largest, positive when it pushes towards more travel; 0 if the
            device does not report it.
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
        """What is tracked now."""

    @property
    def counts(self) -> Mapping[str, int]:
        """How often something went wrong, by its name."""

    def read(self, timeout: float) -> Frame | None:
        """The next frame with the time of its measurement; None when none came in time.

        Args:
            timeout: Seconds to wait.

        Raises:
            DeviceError: The tracker failed.
        """


class LinearStage(Protocol):
    """A stage that slides a sensor: `Slide`, `GcodeSlide`, `RemoteSlide`; a context manager.

    Nothing moves before the travel is known. Every method raises DeviceError when the device fails;
    whatever ends the block, the stage stands still.
    """

    @property
    def counts(self) -> Counter[str]:
        """How many answers were missing or corrupt, by name."""

    def __enter__(self) -> Self:
        """Open the device."""

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        """Stand still and close it."""

    def home_here(self, travel: float) -> None:
        """Declare the stage's travel now, in metres."""

    def home_at_stop(self) -> None:
        """Find the travel by the stage's own stop or switch."""

    def read(self) -> SlideReading:
        """Where the stage is now."""

    def move(self, travel: float) -> Sequence[SlideReading]:
        """Go to a travel in metres; the readings on the way."""

    def follow(self, time: ArrayLike, travel: ArrayLike) -> Iterator[SlideReading]:
        """Follow a path of travels (K,) m at times (K,) s, the first of them now."""

    def pursue(self, wanted: Callable[[float], float], lasts: float) -> Iterator[SlideReading]:
        """Follow a path that is decided on the way: travels in m at seconds from now."""

    def stop(self) -> None:
        """Stand still, at once."""

    def abort(self) -> None:
        """End a motion that another thread waits for, in which it raises DeviceError."""
