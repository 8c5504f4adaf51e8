"""Exceptions and warnings, each with a message of one sentence that a user can act on.

Every message says what is wrong, shows the value, and says what to do. The command line
prints that sentence alone and exits with 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class GlissandoError(ValueError):
    """A file, an option or an array that the user gave is wrong."""


class RecordingError(GlissandoError):
    """A recording or one of its streams cannot be read as it stands."""


class RobotFileError(GlissandoError):
    """A robot file lacks a key, has an unknown key, or holds an impossible value."""


class OutsideGridError(GlissandoError):
    """A reading or a query lies outside the arclengths or times of the grid."""


class UnobservableError(GlissandoError):
    """Prior and readings together leave a direction of the state undetermined."""


class SensorError(GlissandoError):
    """Readings have wrong shapes, or a sensor's derivative does not fit its residual."""


class UnreachableError(SensorError):
    """No shape of the robot agrees with the readings even approximately."""


class SimulationError(GlissandoError):
    """A simulation cannot be run as described: a tendon lies off its disk, a shape is unknown."""


class ImplausibleError(GlissandoError):
    """Readings contradict their description: a unit, a clock, a frame or an axis is wrong."""


class NoShapeError(GlissandoError):
    """No stable static shape under these loads continues the unloaded one."""


class DeviceError(GlissandoError):
    """A device does not answer, or gives an unexpected answer."""


class EstimateWarning(UserWarning):
    """Something is wrong with an estimate."""


class FalseConfidenceWarning(EstimateWarning):
    """Readings contradict the estimate that used them: its covariances are too small."""


class NotConvergedWarning(EstimateWarning):
    """The solver stopped before its steps became small: do not trust the estimate."""


class OldNameWarning(UserWarning):
    """A file uses an earlier name of a key, which is still read and should be replaced."""


class OtherTimesWarning(UserWarning):
    """A stream has no reading at the times for which it is used, or uses another clock."""


class PlanWarning(UserWarning):
    """A plan of the sensor's path is late, missing or deficient."""


def is_interrupt(problem: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error, directly or as that of compiled code, run or imported."""
    while problem is not None and not isinstance(problem, KeyboardInterrupt):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


@contextmanager
def needing(what: str, extra: str, error: type[GlissandoError] = GlissandoError) -> Iterator[None]:
    """Name the extra to install if an import inside the context fails.

    Args:
        what: Beginning of the message, such as 'Figures need matplotlib'.
        extra: Extra of this package that installs the missing one.
        error: Class of the error.

    Raises:
        GlissandoError: A package cannot be imported.
    """
    try:
        yield
    except ImportError as missing:
        if is_interrupt(missing):
            raise
        raise error(f"{what} ({missing}): run pip install 'glissando[{extra}]'.") from missing
