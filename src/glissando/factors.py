"""From readings to factors, and from factors to one block-tridiagonal system."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import SensorError
from glissando.grid import Grid, Index
from glissando.linear import Factors, Residuals
from glissando.noise import sqrt_information
from glissando.points import Interpolation, Points, sort_points
from glissando.prior import Prior
from glissando.readings import Readings
from glissando.se3 import Array
from glissando.slabs import BlockTridiagonal
from glissando.state import DOF, State

_FACTORS = 700  # prior factors linearised together: fewer waste calls, more outgrow the caches


def blocks_of_time(grid: Grid) -> list[slice]:
    """Runs of time nodes to linearise together, so that intermediate arrays stay small."""
    k_count, n_count = grid.shape
    size = max(1, _FACTORS // n_count)
    return [slice(k, min(k + size, k_count)) for k in range(0, k_count, size)]


class PlacedReadings:
    """All readings, sorted by block of time and by the part of a cell they fall in.

    Readings of all sensors that touch equally many nodes are interpolated together. Raises
    OutsideGridError for readings off the grid.
    """

    def __init__(self, grid: Grid, readings: Sequence[Readings]) -> None:
        self.grid = grid
        self.blocks = blocks_of_time(grid)
        self._parts: list[list[tuple[Points, list[Readings]]]] = [[] for _ in self.blocks]
        readings = [r for r in readings if len(r)]
        if not readings:
            return
        for r in readings:
            grid.require(r.arclength, r.time, r.label)
        owner = np.repeat(np.arange(len(readings)), [len(r) for r in readings])
        row = np.concatenate([np.arange(len(r)) for r in readings])
        arclength = np.concatenate([r.arclength for r in readings])
        time = np.concatenate([r.time for r in readings])
        starts = [grid.time[block.start] for block in self.blocks]
        block_of = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
        for i, parts in enumerate(self._parts):
            here = np.flatnonzero(block_of == i)
            for points in sort_points(grid, arclength[here], time[here]):
                mine, rows = owner[here[points.rows]], row[here[points.rows]]
                split = [readings[j].select(rows[mine == j]) for j in np.unique(mine)]
                parts.append((points, split))

    def factors(self, prior: Prior, state: State, about: State, block: int) -> Iterator[Factors]:
        """Factors of one block's readings, covariance widened by the bridge. Source: (13)."""
        for points, readings in self._parts[block]:
            at = prior.interpolate(self.grid, state, about, points)
            first = 0
            for r in readings:
                yield _reading_factors(r, at.take(slice(first, first + len(r))))
                first += len(r)


def _reading_factors(readings: Readings, at: Interpolation) -> Factors:
    m, c = at.nodes.shape
    residual = readings.residual(at.state)
    if residual.shape != (m, readings.row_count):
        raise SensorError(
            f"{readings.label}: residual(at) returns shape {residual.shape}; return "
            f"{(m, readings.row_count)}, a row for each reading."
        )
    if not np.all(np.isfinite(residual)):
        if not np.all(np.isfinite(at.state.pose)):
            raise np.linalg.LinAlgError("the state is not finite")
        row = int(np.argwhere(~np.isfinite(residual))[0, 0])
        raise SensorError(
            f"{readings.label}: the residual of row {row} is not finite; give every reading and "
            f"every state a finite one."
        )
    by_state = readings.jacobian(at.state)
    if by_state.shape != (m, readings.row_count, DOF):
        raise SensorError(
            f"{readings.label}: jacobian(at) returns shape {by_state.shape}; return "
            f"{(m, readings.row_count, DOF)}, or leave it out."
        )
    cov = readings.cov + by_state @ at.cov @ np.swapaxes(by_state, -1, -2)
    by_nodes = (by_state @ at.jacobian.reshape(m, DOF, -1)).reshape(m, -1, c, at.jacobian.shape[-1])
    touched = np.flatnonzero(np.any(by_nodes != 0.0, axis=(0, 1, 2)))
    dofs = slice(int(touched[0]), int(touched[-1]) + 1) if touched.size else slice(0, 1)
    info = sqrt_information(np.broadcast_to(cov, (m, *cov.shape[-2:])))
    terms = Residuals(residual, info, readings.loss)
    return Factors(at.nodes, dofs, by_nodes[..., dofs], terms)


@dataclass(frozen=True)
class NormalEquations:
    """The problem linearised at `state`: system (K slabs of N · dof) · step = right (K, N · dof).

    `about` is the state its weights come from, `terms` the residuals of every factor, always in the
    same order.
    """

    state: State
    about: State
    system: BlockTridiagonal
    right: Array
    terms: list[Residuals]

    def cost_of(self, other: NormalEquations) -> float:
        """Cost of another state's residuals under the weights of this one."""
        return sum(
            mine.cost(theirs.residual) for mine, theirs in zip(self.terms, other.terms, strict=True)
        )


def linearize(
    prior: Prior,
    placed: PlacedReadings,
    state: State,
    about: State,
    room: Array,
    held: Sequence[Residuals] | None = None,
) -> NormalEquations:
    """Normal equations of prior and readings at `state`; the system lives in `room`.

    Weights come from the rates of `about` and count as constants; with `held`, the terms of an
    earlier linearisation, they are the very weights used there.

    `room` is an array of `slab_shape(grid, dof)`, to be used again: it is the largest by far.
    """
    sums = NeighbourSums(placed.grid, state.dof)
    terms: list[Residuals] = []
    for i, times in enumerate(placed.blocks):
        for batch in itertools.chain(
            prior.factors(placed.grid, state, about, times), placed.factors(prior, state, about, i)
        ):
            if held is not None:
                terms_held = replace(batch.terms, sqrt_info=held[len(terms)].sqrt_info)
                batch = replace(batch, terms=terms_held)
            sums.add(batch)
            terms.append(batch.terms)
    system = sums.slabs(room)
    right = sums.right.reshape(placed.grid.time.size, -1)
    return NormalEquations(state, about, system, right, terms)


def slab_shape(grid: Grid, dof: int) -> tuple[int, ...]:
    """Shape of the memory a system needs: diagonal slabs, then those below the diagonal."""
    k_count, n_count = grid.shape
    return 2 * k_count - 1, n_count, dof, n_count, dof


class NeighbourSums:
    """Jᵀ J summed by pairs of neighbouring nodes, and −Jᵀ r by nodes.

    Factors touch a node and its neighbours only, so a block is kept for each node and, by how far
    the row's node is ahead of the column's in (time, arclength), for each pair of neighbours; the
    other half follows by symmetry. These sums are small and dense where the slabs are wide and
    mostly zero.
    """

    def __init__(self, grid: Grid, dof: int) -> None:
        k, n = grid.shape
        self._grid = grid
        self._blocks = {
            ahead: np.zeros((k - ahead[0], n, dof, dof))
            for ahead in ((0, 0), (0, 1), (1, -1), (1, 0), (1, 1))
        }
        self.right = np.zeros((k * n, dof))

    def add(self, batch: Factors) -> None:
        """Add a batch of factors."""
        nodes, hessian, pull = _by_nodes(batch)
        slab, inner = np.divmod(nodes, self._grid.arclength.size)
        for a, b in np.ndindex(nodes.shape[1], nodes.shape[1]):
            ahead = (int(slab[0, a] - slab[0, b]), int(inner[0, a] - inner[0, b]))
            if ahead in self._blocks:
                at = (slab[:, b], inner[:, b], batch.dofs, batch.dofs)
                self._blocks[ahead][at] += hessian[:, a, :, b]
        for a in range(nodes.shape[1]):
            self.right[nodes[:, a], batch.dofs] -= pull[:, a]

    def slabs(self, room: Array) -> BlockTridiagonal:
        """The sums spread out as a block-tridiagonal matrix in `room`."""
        k_count, n_count = self._grid.shape
        room.fill(0.0)
        for (later, further), blocks in self._blocks.items():
            slabs = room[k_count:] if later else room[:k_count]
            for n in range(max(0, -further), n_count - max(0, further)):
                slabs[:, n + further, :, n] = blocks[:, n]
                if (later, further) == (0, 1):
                    slabs[:, n, :, n + 1] = np.swapaxes(blocks[:, n], -1, -2)
        size = n_count * self.right.shape[1]
        flat = room.reshape(2 * k_count - 1, size, size)
        return BlockTridiagonal(flat[:k_count], flat[k_count:])


def _by_nodes(batch: Factors) -> tuple[Index, Array, Array]:
    """Nodes (G, c), Jᵀ J (G, c, d, c, d) and Jᵀ r (G, c, d), summed over factors that share nodes.

    All factors of a batch touch nodes in the same pattern, so the first one tells them apart.
    """
    residual, jacobian = batch.whitened()
    _, c = batch.nodes.shape
    d = batch.jacobian.shape[-1]
    hessian = np.swapaxes(jacobian, -1, -2) @ jacobian
    pull = np.matmul(residual[:, None, :], jacobian)[:, 0]
    nodes, first = batch.nodes, batch.nodes[:, 0]
    if not np.all(np.diff(first) > 0):
        if not np.all(np.diff(first) >= 0):
            order = np.argsort(first, kind="stable")
            nodes, hessian, pull = nodes[order], hessian[order], pull[order]
        starts = np.flatnonzero(np.append(True, np.diff(nodes[:, 0]) > 0))
        hessian, pull = np.add.reduceat(hessian, starts), np.add.reduceat(pull, starts)
        nodes = nodes[starts]
    return nodes, hessian.reshape(-1, c, d, c, d), pull.reshape(-1, c, d)
