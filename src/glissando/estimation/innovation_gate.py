"""What an online estimator thinks of its readings: which to believe, and whether the model fits."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from functools import cache

import numpy as np

from glissando.model.quantiles import chi_square_exceedance

_STRIKES = 10  # readings refused in a row after which a stream is believed again
_REMEMBERED = 50  # innovations that the monitor looks back on
_FALSE_ALARM = 1e-4


@cache
def _beyond(chance: float, dof: int) -> float:
    """What a sum of so many squared standard normals exceeds with that chance."""
    return float(chi_square_exceedance(chance, dof))


class InnovationGate:
    """Counts readings that are refused, and judges innovations.

    A reading is beyond belief when its squared innovation would come by chance once in 1 / `chance`
    times (never, if None), unless its stream has been refused for long.
    """

    def __init__(self, chance: float | None) -> None:
        self.chance = chance
        self.dropped: dict[str, Counter[str]] = {}
        self._strikes: Counter[str] = Counter()
        self._innovations: deque[tuple[float, int]] = deque(maxlen=_REMEMBERED)

    def refuse(self, name: str, reason: str, rows: np.ndarray) -> np.ndarray:
        """Count the rows (M,) that are refused; returns those that are not."""
        if rows.any():
            self.dropped.setdefault(name, Counter())[reason] += int(rows.sum())
        return ~rows

    def excess(self, name: str, nis: Sequence[float], dof: int) -> float:
        """By how much the worst of squared innovations is beyond belief, 1 at the limit."""
        if self.chance is None or self._strikes[name] >= _STRIKES:
            return 0.0
        return max(nis) / _beyond(self.chance, dof)

    def strike(self, name: str) -> None:
        """A reading of the stream has been refused."""
        self._strikes[name] += 1

    def note(self, name: str, nis: Sequence[float], dof: int) -> None:
        """Remember squared innovations, before any is refused."""
        self._innovations.extend((each, dof) for each in nis)
        if self.chance is None or min(nis) <= _beyond(self.chance, dof):
            self._strikes[name] = 0

    @property
    def nis(self) -> float | None:
        """Mean squared innovation per degree of freedom of late; 1 when the model fits."""
        if not self._innovations:
            return None
        total = np.sum(np.array(self._innovations), axis=0)
        return float(total[0] / total[1])

    @property
    def fits(self) -> bool:
        """Whether innovations of late are no larger than chance allows."""
        dof = sum(d for _, d in self._innovations)
        return self.nis is None or self.nis <= _beyond(_FALSE_ALARM, dof) / dof
