"""What fits into the memory of this machine."""

from __future__ import annotations

import os

from glissando.errors import OutsideGridError

_SHARE = 0.6  # of the machine's memory that an estimate may take


def require_memory(wanted: float, what: str, advice: str) -> None:
    """Make sure, before it is taken, that there is memory for an estimate.

    Args:
        wanted: Bytes, about.
        what: What would take them, for the message.
        advice: What to do.

    Raises:
        OutsideGridError: It is more than the machine can give.
    """
    if wanted > _SHARE * _installed():
        raise OutsideGridError(
            f"{what} and about {wanted / 1e9:,.3g} GB, more than {_SHARE:.0%} of this machine's "
            f"{_installed() / 1e9:,.3g} GB; {advice}."
        )


def _installed() -> float:
    """Bytes of memory of this machine; 8 GB where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return 8e9
