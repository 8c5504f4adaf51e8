"""Compiled twins of the innermost functions, for batches too small to hide numpy's calls.

Each takes and gives what its twin in se3, transitions, steps or noise does: any leading shape,
which is broadcast and flattened here, as the compiled loops go over one list of items.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glissando.chains import Chains
from glissando.compiled import chains as chained
from glissando.compiled import intervals as rated
from glissando.compiled import process
from glissando.compiled import se3 as lie
from glissando.compiled import sensors as sensed
from glissando.compiled import steps as stepped
from glissando.compiled import sweep as swept
from glissando.grid import Index
from glissando.linear import Factors, Residuals
from glissando.se3 import Array
from glissando.state import State
from glissando.steps import ARCLENGTH, Direction
from glissando.sweep import Layout
from glissando.transitions import Bridge


def _items(values: Array | float, lead: tuple[int, ...], *own: int) -> Array:
    """Values of every item as one list (M, *own) of contiguous numbers."""
    array = np.asarray(values, dtype=float)
    if array.shape != (*lead, *own):
        spread = np.empty((*lead, *own))  # several times faster than to broadcast and to copy
        spread[...] = array
        array = spread
    return _whole(array).reshape(-1, *own)


def _whole(array: NDArray[Any]) -> NDArray[Any]:
    """Contiguous and writable, as numba compiles anew for every other kind."""
    array = np.ascontiguousarray(array)
    return array if array.flags.writeable else array.copy()


def prepare() -> None:
    """Compile everything, or load what was compiled before: half a minute the first time."""
    x, pose, one, cov = np.zeros((1, 6)), np.eye(4)[None], np.ones(1), np.eye(12)[None]
    exp(x), right_jacobian(x), right_jacobian_inverse(x), right_jacobian_slope(x, x)
    log(pose), inverse(pose), adjoint(pose)
    sqrt_information(cov), pair_sqrt_information(cov)
    pose_slope(pose_miss(pose, pose, pose), pose)
    at, psd = State(pose, x, x), np.ones((1, 6))
    process_covariances(x, one, psd, psd, rigid=True)
    inside = bridge(x, one, 0.5 * one, psd, psd, rigid=True)
    ends, densities = np.zeros((1, 2), np.intp), (psd, psd, psd)
    weighted_steps(ARCLENGTH, at, at, ends, one, one, densities)
    between(ARCLENGTH, at, at, one, 0.5 * one, inside)
    batch = Factors(
        np.zeros((1, 1), np.intp),
        slice(0, 6),
        x[:, None, None],
        Residuals(one[None], one[None, None]),
    )
    layout, block = Layout(1, 6, 0), np.zeros((1, 12, 12))
    add_factors(batch, layout, block, block[0])
    squared_innovations(*spread_out(batch, layout, 1))


def exp(x: Array) -> Array:
    """Twin of that in se3."""
    lead = x.shape[:-1]
    return lie.exp(_items(x, lead, 6)).reshape(*lead, 4, 4)


def log(pose: Array) -> Array:
    """Twin of that in se3."""
    lead = pose.shape[:-2]
    return lie.log(_items(pose, lead, 4, 4)).reshape(*lead, 6)


def inverse(pose: Array) -> Array:
    """Twin of that in se3."""
    return lie.inverse(_items(pose, pose.shape[:-2], 4, 4)).reshape(pose.shape)


def adjoint(pose: Array) -> Array:
    """Twin of that in se3."""
    lead = pose.shape[:-2]
    return lie.adjoint(_items(pose, lead, 4, 4)).reshape(*lead, 6, 6)


def right_jacobian(x: Array) -> Array:
    """Twin of that in se3."""
    lead = x.shape[:-1]
    return lie.right_jacobian(_items(x, lead, 6)).reshape(*lead, 6, 6)


def right_jacobian_inverse(x: Array) -> Array:
    """Twin of that in se3."""
    lead = x.shape[:-1]
    return lie.right_jacobian_inverse(_items(x, lead, 6)).reshape(*lead, 6, 6)


def right_jacobian_slope(x: Array, w: Array) -> Array:
    """Twin of that in se3."""
    lead = np.broadcast_shapes(x.shape, w.shape)[:-1]
    out = lie.right_jacobian_slope(_items(x, lead, 6), _items(w, lead, 6))
    return out.reshape(*lead, 6, 6)


def process_covariances(
    rate: Array,
    step: Array,
    psd: Array,
    carried_psd: Array,
    *,
    rigid: bool,
    jump: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Twin of that in transitions."""
    lead = rate.shape[:-1]
    fields = (_items(field, lead, 6) for field in (psd, carried_psd, jump))
    cov, carried = process.process_covariances(
        _items(rate, lead, 6), _items(step, lead), *fields, rigid
    )
    return cov.reshape(*lead, 12, 12), carried.reshape(*lead, 6, 6)


def bridge(
    rate: Array,
    step: Array,
    offset: Array,
    psd: Array,
    carried_psd: Array,
    jump: Array | float = 0.0,
    *,
    rigid: bool,
) -> Bridge:
    """Twin of that in transitions."""
    lead = rate.shape[:-1]
    fields = (_items(field, lead, 6) for field in (psd, carried_psd, jump))
    places = _items(step, lead), _items(offset, lead)
    found = process.bridge(_items(rate, lead, 6), *places, *fields, rigid)
    return Bridge(*(each.reshape(*lead, *each.shape[1:]) for each in found))


def sqrt_information(cov: Array) -> Array:
    """Twin of that in noise."""
    size = cov.shape[-1]
    return process.sqrt_information(_items(cov, cov.shape[:-2], size, size)).reshape(cov.shape)


def pair_sqrt_information(cov: Array) -> Array:
    """Twin of that in noise."""
    return process.pair_sqrt_information(_items(cov, cov.shape[:-2], 12, 12)).reshape(cov.shape)


def pose_miss(values: Array, pose: Array, mount: Array, *, rolls: bool = False) -> Array:
    """Twin of that in sensors."""
    lead = pose.shape[:-2]
    given = (_items(each, lead, 4, 4) for each in (values, pose, mount))
    return sensed.pose_miss(*given, rolls).reshape(*lead, 6)


def pose_slope(miss: Array, mount: Array, *, rolls: bool = False) -> Array:
    """Twin of that in sensors."""
    lead = miss.shape[:-1]
    out = sensed.pose_slope(_items(miss, lead, 6), _items(mount, lead, 4, 4), rolls)
    return out.reshape(*lead, *out.shape[1:])


def pair_error(
    direction: Direction, start: State, end: State, step: Array
) -> tuple[Array, Array, Array]:
    """Twin of that in steps."""
    lead = start.pose.shape[:-2]
    poses = (_items(at.pose, lead, 4, 4) for at in (start, end))
    rates = (_items(direction.rate_of(at), lead, 6) for at in (start, end))
    error, j0, j1 = stepped.pair_error(*poses, *rates, _items(step, lead), direction.rate.start)
    return error.reshape(*lead, 12), j0.reshape(*lead, 12, 18), j1.reshape(*lead, 12, 18)


def weighted_steps(
    direction: Direction,
    flat: State,
    about: State,
    nodes: Index,
    step: Array,
    weight: Array,
    densities: tuple[Array, Array, Array],
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """Twin of that in kinematic."""
    fields = flat.pose, direction.rate_of(flat), direction.carried_of(flat)
    spread = (_whole(each) for each in densities)
    found = stepped.weighted_steps(
        *map(_whole, fields), _whole(direction.rate_of(about)), _whole(nodes), _whole(step),
        _whole(weight), *spread, direction.rate.start, direction.carried.start, direction.rigid,
    )  # fmt: skip
    return found[:3], found[3:]


def between(
    direction: Direction, start: State, end: State, step: Array, offset: Array, bridge: Bridge
) -> tuple[State, Array, Array, Array]:
    """Twin of that in steps."""
    lead = start.pose.shape[:-2]
    poses = (_items(at.pose, lead, 4, 4) for at in (start, end))
    rates = (_items(direction.rate_of(at), lead, 6) for at in (start, end))
    fields = (_items(direction.carried_of(at), lead, 6) for at in (start, end))
    known = (_items(each, lead, *each.shape[-2:]) for each in vars(bridge).values())
    found = stepped.between(
        *poses, *rates, *fields, _items(step, lead), _items(offset, lead), *known,
        direction.rate.start, direction.carried.start, direction.rigid,
    )  # fmt: skip
    pose, rate, field, *rest = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return direction.build(pose, rate, field), *rest


def _factors(batch: Factors) -> tuple[Array | int, ...]:
    m, r = batch.terms.residual.shape
    extras = np.zeros((m, r, 0)) if batch.extras is None else _whole(batch.extras)
    fields = batch.jacobian, batch.terms.residual, batch.terms.sqrt_info
    return _whole(batch.nodes), batch.dofs.start, *map(_whole, fields), extras


def add_factors(batch: Factors, layout: Layout, blocks: Array, pulls: Array) -> None:
    """Twin of that in sweep."""
    *given, extras = _factors(batch)
    weights = batch.terms.robust_weights()
    shape = layout.nodes, layout.dof, layout.size
    swept.add_factors(*given, weights, extras, *shape, blocks, pulls)


def spread_out(batch: Factors, layout: Layout, count: int) -> tuple[Array, Array]:
    """Twin of that in sweep."""
    shape = layout.nodes, layout.dof, layout.size
    return swept.spread_out(*_factors(batch), *shape, count)


def squared_innovations(residual: Array, known: Array) -> Array:
    """Twin of that in sweep."""
    return swept.squared_innovations(_whole(residual), _whole(known))


def add_to_neighbours(
    batch: Factors, n_count: int, blocks: tuple[Array, ...], right: Array
) -> None:
    """Twin of that in sums."""
    *given, _ = _factors(batch)
    swept.add_to_neighbours(*given, batch.terms.robust_weights(), n_count, blocks, right)


def factor_chains(diagonal: Array, lower: Array) -> Chains:
    """Twin of that in chains."""
    return Chains(*chained.factor_chains(_whole(diagonal), _whole(lower)))


def _rated(at: State, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Poses of nodes that know their strain rate, and their other fields side by side (M, 18)."""
    return _items(at.pose, lead, 4, 4), _items(np.concatenate(at.fields()[1:], -1), lead, 18)


def interval_error(start: State, end: State, step: Array) -> tuple[Array, Array, Array]:
    """Twin of that in intervals."""
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (_rated(at, lead) for at in (start, end))
    found = rated.interval_error(pose0, pose1, fields0, fields1, _items(step, lead))
    error, j0, j1 = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return error, j0, j1


def interval_between(
    start: State, end: State, step: Array, offset: Array, gain: Array, rest: tuple[Array, Array]
) -> tuple[State, Array, Array]:
    """Twin of that in intervals."""
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (_rated(at, lead) for at in (start, end))
    places, known = (_items(each, lead) for each in (step, offset)), _items(gain, lead, 12, 12)
    at_rest = (_items(each, lead, 12) for each in rest)
    found = rated.interval_between(pose0, pose1, fields0, fields1, *places, known, *at_rest)
    pose, fields, j0, j1 = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return State(pose, fields[..., :6], fields[..., 6:12], fields[..., 12:]), j0, j1


def still_steps(
    flat: State, nodes: Index, step: Array, psd: Array, jump: Array
) -> tuple[Array, Array, Array]:
    """Twin of that in moments."""
    given = (_whole(each) for each in (flat.pose, flat.strain, nodes, step, psd, jump))
    error, jacobian, info = stepped.still_steps(*given)
    return error, jacobian, info
