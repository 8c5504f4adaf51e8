"""What can go wrong, as exceptions whose text is one sentence a user can act on.

Every message says what is wrong, shows the value, and says what to do. The command line
prints that sentence alone and exits with 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class GlissandoError(ValueError):
    """A mistake in what was given: files, options or arrays."""


class RecordingError(GlissandoError):
    """A recording or one of its streams cannot be read as it stands."""


class RobotFileError(GlissandoError):
    """A robot file lacks a key, has one too many, or a value that cannot be."""


class OutsideGridError(GlissandoError):
    """A reading or a query lies outside the arclengths or times of the grid."""


class UnobservableError(GlissandoError):
    """Prior and readings together leave a direction of the state undetermined."""


class SensorError(GlissandoError):
    """Readings have wrong shapes, or a sensor's derivative does not fit its residual."""


class UnreachableError(SensorError):
    """No shape of the robot comes near the readings."""


class SimulationError(GlissandoError):
    """What was asked of the simulator cannot be: a tendon off its disk, a shape unknown."""


class ImplausibleError(GlissandoError):
    """Readings cannot be what they are said to be: a unit, a clock, a frame, an axis is wrong."""


class NoShapeError(GlissandoError):
    """The physics has no stable static shape under these loads that continues the unloaded one."""


class DeviceError(GlissandoError):
    """A device does not answer, or answers what it should not."""


class EstimateWarning(UserWarning):
    """Something is wrong with an estimate."""


class FalseConfidenceWarning(EstimateWarning):
    """Readings contradict the estimate that used them: its covariances are too small."""


class NotConvergedWarning(EstimateWarning):
    """The estimate stopped before its step became small: do not trust it."""


class OldNameWarning(UserWarning):
    """A file names something as it was called before; it is read, and should be renamed."""


class OtherTimesWarning(UserWarning):
    """A stream has no reading at the times that it is wanted for, or they are of another clock."""


class PlanWarning(UserWarning):
    """A plan of the sensor's path came too late or not at all, or leaves something out."""


def is_interrupt(problem: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error, directly or inside a kernel, which makes a SystemError."""
    while problem is not None and not isinstance(problem, KeyboardInterrupt):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


@contextmanager
def needing(what: str, extra: str, error: type[GlissandoError] = GlissandoError) -> Iterator[None]:
    """Name the extra to install where a package that is imported inside is missing.

    Args:
        what: What needs which packages, such as 'Figures need matplotlib'.
        extra: The extra that brings them.
        error: Class of the error.

    Raises:
        GlissandoError: A package cannot be imported.
    """
    try:
        yield
    except ImportError as missing:
        raise error(f"{what} ({missing}): run pip install 'glissando[{extra}]'.") from missing
