"""Compiled twins of the innermost functions, for batches too small to hide numpy's calls.

Each takes and gives what its twin in se3, transitions, steps or noise does: any leading shape,
which is broadcast and flattened here, as the compiled loops go over one list of items.
"""

from __future__ import annotations

import numpy as np

from glissando._kernels import intervals as rated
from glissando._kernels import process
from glissando._kernels import se3 as lie
from glissando._kernels import sensors as sensed
from glissando._kernels import steps as stepped
from glissando._kernels.arrays import items, whole
from glissando._kernels.batches import (
    add_factors,
    spread_out,
    squared_innovations,
)
from glissando._kernels.batches import (
    add_to_neighbours as add_to_neighbours,
)
from glissando._kernels.batches import (
    factor_batch as factor_batch,
)
from glissando.estimation.interval_system import Layout
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Index
from glissando.model.priors.steps import ARCLENGTH, Direction
from glissando.model.priors.transitions import Bridge
from glissando.model.state import State


def prepare() -> None:
    """Compile everything, or load what was compiled before: half a minute the first time."""
    x, pose, one, cov = np.zeros((1, 6)), np.eye(4)[None], np.ones(1), np.eye(12)[None]
    exp(x), right_jacobian(x), right_jacobian_inverse(x), right_jacobian_slope(x, x)
    log(pose), inverse(pose), adjoint(pose)
    sqrt_information(cov), pair_sqrt_information(cov)
    pose_slope(pose_miss(pose, pose, pose), pose)
    by_nodes_of(cov[:, :1], cov[:, :, None], cov, cov[:, :1, :1])
    at, psd = State(pose, x, x), np.ones((1, 6))
    process_covariances(x, one, psd, psd, rigid=True)
    bridge(x, one, 0.5 * one, psd, psd, rigid=True)
    ends, densities = np.zeros((1, 2), np.intp), (psd, psd, psd)
    weighted_steps(ARCLENGTH, at, at, ends, one, one, densities)
    bridged(ARCLENGTH, at, at, one, 0.5 * one, x, densities)
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
    return lie.exp(items(x, lead, 6)).reshape(*lead, 4, 4)


def log(pose: Array) -> Array:
    """Twin of that in se3."""
    lead = pose.shape[:-2]
    return lie.log(items(pose, lead, 4, 4)).reshape(*lead, 6)


def inverse(pose: Array) -> Array:
    """Twin of that in se3."""
    return lie.inverse(items(pose, pose.shape[:-2], 4, 4)).reshape(pose.shape)


def adjoint(pose: Array) -> Array:
    """Twin of that in se3."""
    lead = pose.shape[:-2]
    return lie.adjoint(items(pose, lead, 4, 4)).reshape(*lead, 6, 6)


def right_jacobian(x: Array) -> Array:
    """Twin of that in se3."""
    lead = x.shape[:-1]
    return lie.right_jacobian(items(x, lead, 6)).reshape(*lead, 6, 6)


def right_jacobian_inverse(x: Array) -> Array:
    """Twin of that in se3."""
    lead = x.shape[:-1]
    return lie.right_jacobian_inverse(items(x, lead, 6)).reshape(*lead, 6, 6)


def right_jacobian_slope(x: Array, w: Array) -> Array:
    """Twin of that in se3."""
    lead = np.broadcast_shapes(x.shape, w.shape)[:-1]
    out = lie.right_jacobian_slope(items(x, lead, 6), items(w, lead, 6))
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
    fields = (items(field, lead, 6) for field in (psd, carried_psd, jump))
    cov, carried = process.process_covariances(
        items(rate, lead, 6), items(step, lead), *fields, rigid
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
    fields = (items(field, lead, 6) for field in (psd, carried_psd, jump))
    places = items(step, lead), items(offset, lead)
    found = process.bridge(items(rate, lead, 6), *places, *fields, rigid)
    return Bridge(*(each.reshape(*lead, *each.shape[1:]) for each in found))


def sqrt_information(cov: Array) -> Array:
    """Twin of that in noise."""
    size = cov.shape[-1]
    return process.sqrt_information(items(cov, cov.shape[:-2], size, size)).reshape(cov.shape)


def pair_sqrt_information(cov: Array) -> Array:
    """Twin of that in noise."""
    return process.pair_sqrt_information(items(cov, cov.shape[:-2], 12, 12)).reshape(cov.shape)


def pose_miss(values: Array, pose: Array, mount: Array, *, rolls: bool = False) -> Array:
    """Twin of that in sensors."""
    lead = pose.shape[:-2]
    given = (items(each, lead, 4, 4) for each in (values, pose, mount))
    return sensed.pose_miss(*given, rolls).reshape(*lead, 6)


def pose_slope(miss: Array, mount: Array, *, rolls: bool = False) -> Array:
    """Twin of that in sensors."""
    lead = miss.shape[:-1]
    out = sensed.pose_slope(items(miss, lead, 6), items(mount, lead, 4, 4), rolls)
    return out.reshape(*lead, *out.shape[1:])


def by_nodes_of(by_state: Array, jacobian: Array, left: Array, cov: Array) -> tuple[Array, Array]:
    """Twin of that in placed."""
    m, r = by_state.shape[:2]
    given = whole(by_state), whole(jacobian), whole(left)
    return sensed.by_nodes_of(*given, items(cov, (m,), r, r))


def pair_error(
    direction: Direction, start: State, end: State, step: Array
) -> tuple[Array, Array, Array]:
    """Twin of that in steps."""
    lead = start.pose.shape[:-2]
    poses = (items(at.pose, lead, 4, 4) for at in (start, end))
    rates = (items(direction.rate_of(at), lead, 6) for at in (start, end))
    error, j0, j1 = stepped.pair_error(*poses, *rates, items(step, lead), direction.rate.start)
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
    spread = (whole(each) for each in densities)
    found = stepped.weighted_steps(
        *map(whole, fields), whole(direction.rate_of(about)), whole(nodes), whole(step),
        whole(weight), *spread, direction.rate.start, direction.carried.start, direction.rigid,
    )  # fmt: skip
    return found[:3], found[3:]


def bridged(
    direction: Direction,
    start: State,
    end: State,
    step: Array,
    offset: Array,
    about: Array,
    densities: tuple[Array, Array, Array],
) -> tuple[State, Array, Array, Array]:
    """Twin of that in steps."""
    lead, rigid = start.pose.shape[:-2], direction.rigid
    poses = (items(at.pose, lead, 4, 4) for at in (start, end))
    rates = (items(direction.rate_of(at), lead, 6) for at in (start, end))
    fields = (items(direction.carried_of(at), lead, 6) for at in (start, end))
    places = items(step, lead), items(offset, lead)
    spread = (items(each, lead, 6) for each in densities)
    known = process.bridge(items(about, lead, 6), *places, *spread, rigid)
    found = stepped.between(
        *poses, *rates, *fields, *places, *known,
        direction.rate.start, direction.carried.start, rigid,
    )  # fmt: skip
    pose, rate, field, *rest = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return direction.build(pose, rate, field), *rest


def _rated(at: State, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Poses of nodes that know their strain rate, and their other fields side by side (M, 18)."""
    return items(at.pose, lead, 4, 4), items(np.concatenate(at.fields()[1:], -1), lead, 18)


def interval_error(start: State, end: State, step: Array) -> tuple[Array, Array, Array]:
    """Twin of that in intervals."""
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (_rated(at, lead) for at in (start, end))
    found = rated.interval_error(pose0, pose1, fields0, fields1, items(step, lead))
    error, j0, j1 = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return error, j0, j1


def interval_between(
    start: State, end: State, step: Array, offset: Array, gain: Array, rest: tuple[Array, Array]
) -> tuple[State, Array, Array]:
    """Twin of that in intervals."""
    lead = start.pose.shape[:-2]
    (pose0, fields0), (pose1, fields1) = (_rated(at, lead) for at in (start, end))
    places, known = (items(each, lead) for each in (step, offset)), items(gain, lead, 12, 12)
    at_rest = (items(each, lead, 12) for each in rest)
    found = rated.interval_between(pose0, pose1, fields0, fields1, *places, known, *at_rest)
    pose, fields, j0, j1 = (each.reshape(*lead, *each.shape[1:]) for each in found)
    return State(pose, fields[..., :6], fields[..., 6:12], fields[..., 12:]), j0, j1


def static_steps(
    flat: State, nodes: Index, step: Array, psd: Array, jump: Array
) -> tuple[Array, Array, Array]:
    """Twin of that in moments."""
    given = (whole(each) for each in (flat.pose, flat.strain, nodes, step, psd, jump))
    error, jacobian, info = stepped.static_steps(*given)
    return error, jacobian, info
