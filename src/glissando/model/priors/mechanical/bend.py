"""Steps of a rod's state after which poses still follow from the wrenches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.priors.intervals import strain_rate_of
from glissando.model.priors.mechanical.intervals import Intervals, interval_end, interval_error
from glissando.model.priors.static import STATIC_DOF
from glissando.model.state import State

_SHOTS = 2
_STATIC = slice(0, STATIC_DOF)


@np.errstate(over="ignore", invalid="ignore")
def retract_strains(
    pieces: Sequence[Intervals],
    tip_error: Callable[[State], tuple[Array, Array]],
    state: State,
    step: Array,
) -> State:
    """State after a `step` (K, N, 24), built interval by interval from the base outwards.

    The errors of intervals and of the tip change by the step to first order, so that poses and
    wrenches stay consistent however long it is. The wrench at the base is found by shooting.

    Args:
        pieces: Intervals (K,) between neighbours of the N arclength nodes.
        tip_error: Function for error (K, 12) and Jacobian (K, 12, 24) of tips.
        state: States (K, N) of the nodes.
        step: Step (K, N, 24) of the nodes.
    """
    errors = []
    for n, piece in enumerate(pieces):
        error, slopes = interval_error(state.take(np.s_[:, n]), state.take(np.s_[:, n + 1]), piece)
        change = np.einsum("kicd,kcd->ki", slopes, step[:, n : n + 2])
        errors.append(error + change)
    error, slope = tip_error(state.take(np.s_[:, -1]))
    wanted = error + (slope @ step[:, -1, :, None])[..., 0]
    start = state.take(np.s_[:, 0]).retract(step[:, 0])
    for _ in range(_SHOTS):
        nodes, by_base = _shot(pieces, start, errors)
        error, slope = tip_error(nodes[-1])
        by_base = slope[:, :6, _STATIC] @ by_base
        miss = (wanted - error).reshape(len(step), 2, 6)
        try:
            correction = np.linalg.solve(by_base[:, None], miss[..., None])[..., 0]
        except np.linalg.LinAlgError:  # so far off that the tip does not depend on the base
            break
        by_strain, by_rate = correction[:, 0], correction[:, 1]
        strain, rate = start.strain + by_strain, strain_rate_of(start) + by_rate
        start = replace(start, strain=strain, strain_rate=rate)
    nodes, _ = _shot(pieces, start, errors)
    fields = zip(*(node.fields() for node in nodes), strict=True)
    return State(*(np.stack(field, axis=1) for field in fields))


def _shot(
    pieces: Sequence[Intervals], start: State, errors: Sequence[Array]
) -> tuple[list[State], Array]:
    """States of rods with given `errors`, Jacobian (K, 12, 6) of the last by the base's strain."""
    nodes = [start]
    by_base = np.zeros((len(start.strain), 12, 6))
    by_base[:, 6:] = np.eye(6)
    for piece, error in zip(pieces, errors, strict=True):
        end, onward = interval_end(nodes[-1], error, piece)
        nodes.append(end)
        by_base = onward @ by_base
    return nodes, by_base
