"""Innovation gate of an online estimator, and a monitor of whether the model fits."""

from __future__ import annotations

from collections import Counter, deque
from functools import cache

import numpy as np

from glissando.model.quantiles import chi_square_exceedance

_STRIKES = 10  # readings refused in a row after which a stream is accepted again
_REMEMBERED = 50  # innovations over which the monitor averages
_FALSE_ALARM = 1e-4


@cache
def _chi_square_limit(chance: float, dof: int) -> float:
    """Value that a χ² variable of `dof` degrees of freedom exceeds with this probability."""
    return float(chi_square_exceedance(chance, dof))


class InnovationGate:
    """Tests innovations and counts readings that are refused.

    A reading is refused when the probability of so large a squared innovation is below `chance`
    (never, if None), unless its stream has been refused for long. Where a stream repeatedly reads
    the same places, each place is counted by itself, as one near the base always fits.
    """

    def __init__(self, chance: float | None) -> None:
        self.chance = chance
        self.dropped: dict[str, Counter[str]] = {}
        self._strikes: Counter[tuple[str, float | None]] = Counter()
        self._places: dict[str, list[float]] = {}  # arclengths of a stream's last readings
        self._repeated: dict[str, set[float]] = {}  # those of them that readings before had as well
        self._innovations: deque[tuple[float, int]] = deque(maxlen=_REMEMBERED)

    def refuse(self, name: str, reason: str, rows: np.ndarray) -> np.ndarray:
        """Count the rows (M,) of a mask as refused; return the mask of the others."""
        if rows.any():
            self.dropped.setdefault(name, Counter())[reason] += int(rows.sum())
        return ~rows

    def excess(
        self, name: str, arclength: list[float], nis: list[float], dof: int
    ) -> tuple[float, int]:
        """Largest ratio of a squared innovation to its limit, and the index of that reading."""
        if self.chance is None:
            return 0.0, 0
        most = max(nis)
        if most > (limit := _chi_square_limit(self.chance, dof)) and self._strikes:
            judged = [
                0.0 if self._strikes[self._key(name, place)] >= _STRIKES else each
                for place, each in zip(arclength, nis, strict=True)
            ]
            most, nis = max(judged), judged
        return most / limit, nis.index(most)

    def strike(self, name: str, arclength: float) -> None:
        """Count a refused reading of a stream."""
        self._strikes[self._key(name, arclength)] += 1

    def note(self, name: str, arclength: list[float], nis: list[float], dof: int) -> None:
        """Record squared innovations, before any reading is refused."""
        self._innovations.extend((each, dof) for each in nis)
        self._repeated[name] = set(arclength).intersection(self._places.get(name, ()))
        self._places[name] = arclength
        if self._strikes:
            limit = np.inf if self.chance is None else _chi_square_limit(self.chance, dof)
            for place, each in zip(arclength, nis, strict=True):
                if each <= limit:
                    self._strikes.pop(self._key(name, place), None)

    def _key(self, name: str, arclength: float) -> tuple[str, float | None]:
        return name, arclength if arclength in self._repeated.get(name, ()) else None

    @property
    def nis(self) -> float | None:
        """Mean recent squared innovation per degree of freedom; 1 when the model fits."""
        if not self._innovations:
            return None
        total = np.sum(np.array(self._innovations), axis=0)
        return float(total[0] / total[1])

    @property
    def fits(self) -> bool:
        """Whether recent innovations are no larger than chance allows."""
        dof = sum(d for _, d in self._innovations)
        return self.nis is None or self.nis <= _chi_square_limit(_FALSE_ALARM, dof) / dof
