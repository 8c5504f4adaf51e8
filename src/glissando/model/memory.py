"""A check that an estimate fits into the memory of this machine."""

from __future__ import annotations

import os

from glissando.errors import OutsideGridError

_SHARE = 0.6  # of the machine's memory that an estimate may take


def require_memory(wanted: float, what: str, advice: str) -> None:
    """Check, before allocation, that the machine has the memory for an estimate.

    Args:
        wanted: Approximate number of bytes.
        what: Beginning of the message: what needs them.
        advice: End of the message: what to do.

    Raises:
        OutsideGridError: More than the admissible share of the machine's memory is needed.
    """
    if wanted > _SHARE * _installed():
        raise OutsideGridError(
            f"{what} and about {wanted / 1e9:,.3g} GB, more than {_SHARE:.0%} of this machine's "
            f"{_installed() / 1e9:,.3g} GB; {advice}."
        )


def _installed() -> float:
    """Memory of this machine in bytes; 8 GB where the system does not report it."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return 8e9
