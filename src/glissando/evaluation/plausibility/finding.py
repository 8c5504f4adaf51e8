"""Findings of the plausibility checks, and the names of the checks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from glissando.errors import GlissandoError, ImplausibleError

CHECKS = {
    "accelerometer": "an accelerometer's unit, signs or axes against gravity",
    "axes": "coordinate axes swapped, mirrored, or turned against each other",
    "base": "readings that fit together but not on the robot's base",
    "clock": "streams whose times do not meet, or a clock that jumps",
    "fibre": "a fibre's order of cores, angles, radii or sign against tracked bodies",
    "fit": "streams that the estimate does not follow",
    "frame": "a frame inverted, left out, in millimetres or with another quaternion order",
    "grid": "more time nodes than readings could need, or too few for the confidence between",
    "gyro": "a gyroscope's unit, signs or axes against the turning of tracked bodies",
    "lag": "streams whose motion comes later or earlier than that of the others",
    "length-unit": "positions, arclengths or mounts that are not in metres",
    "mount": "a sensor whose z axis does not run along the robot",
    "noise": "stated noise against the noise that is seen",
    "pace": "a robot so slow that its prior forgets what a sliding sensor has just read",
    "quaternion": "another order or direction of rotations",
    "reach": "readings farther from the base than the robot is long",
    "sampling": "rows that stand there twice, coarse stamps, values that freeze",
    "shape": "readings that no shape of the robot explains",
    "slide": "a slide's direction, scale, zero and lateness against the sensor's motion",
    "speed": "motion faster than a robot moves",
    "time-unit": "times that are not in seconds",
}
"""Names of the checks, as for `--allow`, and the mistakes that each finds."""


@dataclass(frozen=True)
class Finding:
    """A finding of a plausibility check.

    Attributes:
        name: Name of the check, one of `CHECKS`, or "guard" for a failure of the checks themselves.
        sentence: Message with the mistake, the value seen, the likely cause, and the remedy.
        refusal: Whether an estimate would be meaningless and is refused; otherwise a warning.
        streams: Names of the streams concerned.
        correction: The change that would make the readings plausible; empty if none was found.
    """

    name: str
    sentence: str
    refusal: bool
    streams: tuple[str, ...] = ()
    correction: str = ""

    def as_json(self) -> dict[str, object]:
        """The finding as a JSON object."""
        return {**vars(self), "streams": list(self.streams)}


def listed(names: Sequence[str]) -> str:
    """The first three names as text, quoted, and the number of further ones."""
    shown = ", ".join(repr(name) for name in names[:3])
    return shown + f" and {len(names) - 3} more" * (len(names) > 3)


def require_known(allow: Iterable[str]) -> None:
    """Raise unless every name is that of a check.

    Args:
        allow: Names of checks to skip.

    Raises:
        GlissandoError: A name is not that of a check.
    """
    for name in allow:
        if name not in CHECKS:
            raise GlissandoError(f"--allow {name!r} is not a check; known: {', '.join(CHECKS)}.")


def refuse(findings: Sequence[Finding]) -> None:
    """Raise if a finding is a refusal.

    Args:
        findings: Findings of the checks.

    Raises:
        ImplausibleError: At least one finding is a refusal; the message names the option that
            skips the checks.
    """
    refusals = [finding for finding in findings if finding.refusal]
    if refusals:
        names = ",".join(dict.fromkeys(finding.name for finding in refusals))
        sentences = " ".join(finding.sentence for finding in refusals)
        raise ImplausibleError(f"{sentences} If that is as it should be: --allow {names}")
