"""Times as text, with enough digits to distinguish Unix times."""

from __future__ import annotations


def seconds(*times: float, decimals: int = 3) -> str:
    """Format times in seconds with at most `decimals` decimals and all integer digits.

    >>> seconds(1.7e9 + 0.25, 1.7e9 + 3.0), seconds(1.0 / 3.0)
    ('1700000000.25 to 1700000003', '0.333')
    """
    texts = (f"{time:.{decimals}f}" for time in times)
    return " to ".join(t.rstrip("0").rstrip(".") if "." in t else t for t in texts)
